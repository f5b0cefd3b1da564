"""Judge a trained model on each split, beside the trivial predictors: data/evaluate/<model>/."""

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS, load
from pipeline.fitting import checkpoint
from pipeline.report import judge as metrics
from pipeline.report import plots
from pipeline.sections.evaluate import Evaluate
from pipeline.sections.models import Model
from pipeline.train import frames, windows

if TYPE_CHECKING:
    from models.steering.core.steering_net import SteeringNet

COLUMNS = ("drive", "frame", "time_s", "speed_mps", "steering_rad", "predicted_rad", "valid")


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models: in the params file")],
    train: Annotated[Path, typer.Option(help="holds the model's folder")] = Path("data/train"),
    graphs: Path = Path("data/graphs"),
    labels: Path = Path("data/labels"),
    out: Annotated[Path, typer.Option(help="the model gets a folder in it")] = Path("data/evaluate"),
    params: Path = Path("params.yaml"),
) -> None:
    """Write metrics.json, predictions.csv and a plot of the test drives; predictions of further seeds in folders.

    Invalid frames have no say in any figure. Figures are means over the seeds.
    """
    from pipeline.train import fit as steering_fit

    section = load(Evaluate, params)
    config = store.read_json(train / name / "config.json", stage=f"train@{name}")
    line = Model.model_validate(config["model"])
    variant = graphs / line.input
    splits = store.read_index(variant, stage="graphs")
    data = {split: windows.read_drives(variant, labels, store.of_split(splits, split), line.window) for split in SPLITS}
    found = {
        seed: _predict(name, folder, seed, line, variant, data)
        for seed, folder in steering_fit.folders(train / name, config["seeds"]).items()
    }

    result: dict[str, Any] = {
        "model": name,
        "line": line.model_dump(),
        "seeds": list(found),
        "drives": {split: store.of_split(splits, split) for split in SPLITS},
        "parameters": config["parameters"],
        "encode_ms_per_frame": config["encode_ms_per_frame"],
        **_sizes(data["test"]),
    }
    for split, drives in data.items():
        of_seeds = [predicted[split] for predicted in found.values()]
        result[split] = _judge(drives, of_seeds, section, config["target"]["mean_rad"]) if drives else None
    store.write_json(out / name / "metrics.json", result)
    for seed, folder in steering_fit.folders(out / name, config["seeds"]).items():
        _write_predictions(folder / "predictions.csv", data["test"], found[seed]["test"])
    test = result["test"]
    title = f"{name}: nmse {test['nmse']:.3f}" + (f" (mean of {len(found)} seeds, one shown)" if len(found) > 1 else "")
    plots.steering(out / name / "steering.png", data["test"], found[config["seeds"][0]]["test"], title)
    spread = "" if test["nmse_std"] is None else f" ± {test['nmse_std']:.3f} over {len(found)} seeds"
    low, high = test["nmse_ci95"]
    print(
        f"{name}: test nmse {test['nmse']:.3f}{spread} [{low:.3f}, {high:.3f}], "
        f"mean error {test['mae_deg']:.2f} deg over {test['frames']} frames"
    )


def _predict(
    name: str, folder: Path, seed: int, line: Model, variant: Path, data: dict[str, list[windows.Drive]]
) -> dict[str, list[np.ndarray]]:
    """Return for each split what the network of one seed predicts, [G] rad for each drive."""
    import torch

    from models.steering.core import steering_net
    from pipeline.train import fit as steering_fit

    again = f"Train it again: dvc repro --force train@{name}"
    trained = checkpoint.read(folder / "best.pt", steering_fit.KIND, again)
    if (trained["name"], trained["model"], trained["seed"]) != (name, line.model_dump(), seed):
        raise InputError(
            f"{folder / 'best.pt'} is of model {trained['name']}, seed {trained['seed']}, and not what config.json "
            f"beside it says. {again}"
        )
    net = _build(name, line, variant, again)
    checkpoint.load_state(net, trained["net"], folder / "best.pt", again)
    net.to("cuda" if torch.cuda.is_available() else "cpu")
    target = steering_fit.Target(**trained["target"])
    return {
        split: steering_fit.predict_drives(net, steering_net.predict, drives, line.window, target)
        for split, drives in data.items()
    }


def _build(name: str, line: Model, variant: Path, again: str) -> "SteeringNet":
    from models.steering.core import steering_net

    first = next(iter(store.read_index(variant, stage="graphs")))
    try:
        return steering_net.build(line.model_dump(), **frames.contents(variant / f"{first}.h5"))
    except ValueError as error:
        raise InputError(f"models.{name}: {error}. {again}") from error


def _judge(
    drives: list[windows.Drive], predicted_rad: list[list[np.ndarray]], section: Evaluate, train_mean_rad: float
) -> dict[str, Any]:
    """Return the figures of one split, of predictions by seed and drive.

    Frames that are invalid or too early for a whole window do not count.
    """
    judged = [drive.valid & ~np.isnan(found) for drive, found in zip(drives, predicted_rad[0], strict=True)]

    def column(of_drive: list[np.ndarray]) -> np.ndarray:
        return np.concatenate([values[rows] for values, rows in zip(of_drive, judged, strict=True)])

    steering = column([drive.steering_rad for drive in drives])
    found = np.stack([column(of_seed) for of_seed in predicted_rad])  # [S,N]
    before = column([metrics.last_valid(drive.steering_rad, drive.valid) for drive in drives])
    number = column([np.full(len(drive.frame), index) for index, drive in enumerate(drives)])
    curvature = column([drive.curvature_1pm for drive in drives])
    interval = metrics.nmse_interval(
        steering, found, number, section.bootstrap_block_frames, section.bootstrap_samples, section.seed
    )
    return metrics.scores(steering, found) | {
        "nmse_std": metrics.nmse_std(steering, found),
        "nmse_ci95": list(interval),
        "baselines": metrics.baselines(steering, before, train_mean_rad),
        "by_curvature": metrics.by_curvature(steering, found, curvature, section.curvature_bins_1pm),
    }


def _sizes(drives: list[windows.Drive]) -> dict[str, float | None]:
    """Return means over the drives' frames: points, kNN edges before and after pruning; None for what there is not."""
    counts: dict[str, list[np.ndarray]] = {"points": [], "edges_knn": [], "edges_kept": []}
    for drive in drives:
        with store.DriveReader(drive.graphs, stage="graphs") as file:
            if "ptr" in file:
                counts["points"].append(np.diff(file["ptr"]))
            for name in ("edges_knn", "edges_kept"):
                if name in file:
                    counts[name].append(file[name])
    points, knn, kept = (float(np.concatenate(parts).mean()) if parts else None for parts in counts.values())
    return {"points_per_frame": points, "edges_per_frame": kept, "edges_per_frame_unpruned": knn}


def _write_predictions(path: Path, drives: list[windows.Drive], predicted_rad: list[np.ndarray]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for drive, found in zip(drives, predicted_rad, strict=True):
            for row in range(len(drive.frame)):
                angle = "" if np.isnan(found[row]) else f"{found[row]:.6f}"
                rows.writerow([
                    drive.name, drive.frame[row], f"{drive.time_s[row]:.6f}", f"{drive.speed_mps[row]:.4f}",
                    f"{drive.steering_rad[row]:.9f}", angle, int(drive.valid[row]),
                ])  # fmt: skip


if __name__ == "__main__":
    console.run(main)
