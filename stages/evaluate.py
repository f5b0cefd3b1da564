"""Judge a trained model on each split, beside the trivial predictors: data/evaluate/<model>/."""

import csv
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pipeline import checkpoint, console, frames, metrics, plots, store, windows
from pipeline.errors import InputError
from pipeline.params import SPLITS, load
from pipeline.sections.evaluate import Evaluate
from pipeline.sections.models import Model

COLUMNS = ("drive", "frame", "time_s", "speed_mps", "steering_rad", "predicted_rad", "valid")


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models: in the params file")],
    train: Annotated[Path, typer.Option(help="holds the model's folder")] = Path("data/train"),
    graphs: Path = Path("data/graphs"),
    labels: Path = Path("data/labels"),
    out: Annotated[Path, typer.Option(help="the model gets a folder in it")] = Path("data/evaluate"),
    params: Path = Path("params.yaml"),
) -> None:
    """Write metrics.json, predictions.csv and a plot of the test drives. Invalid frames have no say in any figure."""
    import torch

    from models import steering_net
    from pipeline import steering_fit

    section = load(Evaluate, params)
    again = f"Train it again: dvc repro --force train@{name}"
    config = store.read_json(train / name / "config.json", stage=f"train@{name}")
    trained = checkpoint.read(train / name / "best.pt", steering_fit.KIND, again)
    line, target = Model.model_validate(trained["model"]), steering_fit.Target(**trained["target"])
    variant = graphs / line.input
    splits = store.read_index(variant, stage="graphs")
    try:
        net = steering_net.build(line.model_dump(), **frames.contents(variant / f"{next(iter(splits))}.h5"))
    except ValueError as error:
        raise InputError(f"models.{name}: {error}. {again}") from error
    checkpoint.load_state(net, trained["net"], train / name / "best.pt", again)
    net.to("cuda" if torch.cuda.is_available() else "cpu")

    result: dict[str, Any] = {"model": name, "drives": {split: store.of_split(splits, split) for split in SPLITS}}
    for split, drives in result["drives"].items():
        data = windows.read_drives(variant, labels, drives, line.window)
        found = steering_fit.predict_drives(net, steering_net.predict, data, line.window, target)
        result_of_split = _judge(data, found, section, target.mean_rad) if data else None
        result[split] = result_of_split
    store.write_json(out / name / "metrics.json", result | {
        "parameters": config["parameters"],
        "encode_ms_per_frame": config["encode_ms_per_frame"],
        "edges_per_frame": _edges_per_frame(data),
    })  # fmt: skip
    # `data` and `found` are those of the last split, test.
    _write_predictions(out / name / "predictions.csv", data, found)
    plots.steering(out / name / "steering.png", data, found, f"{name}: nmse {result['test']['nmse']:.3f}")
    low, high = result["test"]["nmse_ci95"]
    print(
        f"{name}: test nmse {result['test']['nmse']:.3f} [{low:.3f}, {high:.3f}], "
        f"mean error {result['test']['mae_deg']:.2f} deg over {result['test']['frames']} frames"
    )


def _judge(
    drives: list[windows.Drive], predicted_rad: list[np.ndarray], section: Evaluate, train_mean_rad: float
) -> dict[str, Any]:
    """Return the figures of one split; frames that are invalid or too early for a whole window do not count."""
    judged = [drive.valid & ~np.isnan(found) for drive, found in zip(drives, predicted_rad, strict=True)]

    def column(of_drive: list[np.ndarray]) -> np.ndarray:
        return np.concatenate([values[rows] for values, rows in zip(of_drive, judged, strict=True)])

    steering = column([drive.steering_rad for drive in drives])
    found = column(predicted_rad)
    before = column([metrics.last_valid(drive.steering_rad, drive.valid) for drive in drives])
    number = column([np.full(len(drive.frame), index) for index, drive in enumerate(drives)])
    curvature = column([drive.curvature_1pm for drive in drives])
    interval = metrics.nmse_interval(
        steering, found, number, section.bootstrap_block_frames, section.bootstrap_samples, section.seed
    )
    return metrics.scores(steering, found) | {
        "nmse_ci95": list(interval),
        "baselines": metrics.baselines(steering, before, train_mean_rad),
        "by_curvature": metrics.by_curvature(steering, found, curvature, section.curvature_bins_1pm),
    }


def _edges_per_frame(drives: list[windows.Drive]) -> float | None:
    """Return the mean number of kNN edges that pruning left, over the drives' frames; None if the input has none."""
    kept = []
    for drive in drives:
        with store.DriveReader(drive.graphs, stage="graphs") as file:
            if "edges_kept" not in file:
                return None
            kept.append(file["edges_kept"])
    return float(np.concatenate(kept).mean())


def _write_predictions(path: Path, drives: list[windows.Drive], predicted_rad: list[np.ndarray]) -> None:
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
