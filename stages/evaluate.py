"""Judge a trained model on each split, beside the trivial predictors: data/evaluate/<model>/."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.base.lock import held
from pipeline.base.params import SPLITS, load
from pipeline.report.judge import predictions, split, steering_plot
from pipeline.sections.evaluate import Evaluate
from pipeline.train import frames, predict, seeds, windows


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models: in the params file")],
    train: Annotated[Path, typer.Option(help="holds the model's folder")] = Path("data/train"),
    graphs: Path = Path("data/graphs"),
    labels: Path = Path("data/labels"),
    out: Annotated[Path, typer.Option(help="the model gets a folder in it")] = Path("data/evaluate"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write metrics.json, predictions.csv and a plot of the test drives; predictions of further seeds in folders.

    Invalid frames have no say in any figure. Figures are means over the seeds. Returns the model's folder.
    """
    with held(out / name, out.parent / ".resume" / f"{out.name}-{name}"):
        return _evaluate(name, train, graphs, labels, out, load(Evaluate, params))


def _evaluate(name: str, train: Path, graphs: Path, labels: Path, out: Path, settings: Evaluate) -> Path:
    config = store.read_json(train / name / "config.json", stage=f"train@{name}")
    line = config["model"]
    variant = graphs / line["input"]
    splits = store.read_index(variant, stage="graphs")
    drives = {
        of: windows.read_drives(variant, labels, store.of_split(splits, of), line["window"]) for of in SPLITS
    }  # fmt: skip
    predicted = {
        seed: _predict(_load(folder, name, seed, config), drives)
        for seed, folder in seeds.folders(train / name, config["seeds"]).items()
    }

    result: dict[str, Any] = {
        "model": name,
        "line": line,
        "seeds": config["seeds"],
        "drives": {of: store.of_split(splits, of) for of in SPLITS},
        "parameters": config["parameters"],
        "encode_ms_per_frame": config["encode_ms_per_frame"],
        **split.sizes(drives["test"]),
    }
    for of in SPLITS:
        by_seed = [of_seed[of] for of_seed in predicted.values()]
        mean_rad = config["target"]["mean_rad"]
        result[of] = split.figures(drives[of], by_seed, settings, mean_rad) if drives[of] else None
    store.write_json(out / name / "metrics.json", result)
    for seed, folder in seeds.folders(out / name, config["seeds"]).items():
        predictions.write(folder / "predictions.csv", drives["test"], predicted[seed]["test"])
    _draw_and_say(out / name / "steering.png", result, drives["test"], predicted[config["seeds"][0]]["test"])
    return out / name


def _load(folder: Path, name: str, seed: int, config: Mapping[str, Any]) -> predict.Trained:
    model = predict.load(folder)
    if (model.name, model.line, model.seed) != (name, config["model"], seed):
        raise InputError(
            f"{folder / 'best.pt'} is of model {model.name}, seed {model.seed}, and not what config.json beside it "
            f"says. Train it again: dvc repro --force train@{name}"
        )
    return model


def _predict(model: predict.Trained, drives: Mapping[str, list[windows.Drive]]) -> dict[str, list[np.ndarray]]:
    """Return for each split what the model predicts, [G] rad for each drive."""
    predicted: dict[str, list[np.ndarray]] = {of: [] for of in drives}
    for of, of_split in drives.items():
        for drive in of_split:
            with frames.open_graphs(drive.graphs) as graphs:
                predicted[of].append(model.predict(graphs))
    return predicted


def _draw_and_say(
    path: Path, result: Mapping[str, Any], drives: list[windows.Drive], predicted_rad: list[np.ndarray]
) -> None:
    """Draw the test drives with one seed's predictions, and print the test's figures."""
    name, test, count = result["model"], result["test"], len(result["seeds"])
    steering_plot.draw(
        path,
        drives,
        predicted_rad,
        f"{name}: nmse {test['nmse']:.3f}" + (f" (mean of {count} seeds, one shown)" if count > 1 else ""),
    )
    spread = "" if test["nmse_std"] is None else f" ± {test['nmse_std']:.3f} over {count} seeds"
    low, high = test["nmse_ci95"]
    print(
        f"{name}: test nmse {test['nmse']:.3f}{spread} [{low:.3f}, {high:.3f}], "
        f"mean error {test['mae_deg']:.2f} deg over {test['frames']} frames"
    )


if __name__ == "__main__":
    console.run(main)
