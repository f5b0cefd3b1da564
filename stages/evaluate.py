"""Judge a trained model on each split, beside the trivial predictors: data/evaluate/<model>/."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.base.lock import exclusive
from pipeline.base.params import SPLITS, load
from pipeline.report.judge import neurons, predictions, split, steering_plot, structure
from pipeline.sections.evaluate import Evaluate
from pipeline.train import frames, predict, runs, windows


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models: in the params file")],
    train: Annotated[Path, typer.Option(help="holds the model's folder")] = Path("data/train"),
    graphs: Path = Path("data/graphs"),
    labels: Path = Path("data/labels"),
    out: Annotated[Path, typer.Option(help="the model gets a folder in it")] = Path("data/evaluate"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write metrics.json, and of the test drives predictions.csv, a plot and a graph; further seeds have folders.

    Invalid frames have no say in any figure. Figures are means over the seeds. A network that is fitted to some of the
    test drives judges the one that it has not seen; of the drives that several were fitted to, the first judges each.
    Returns the model's folder.
    """
    with exclusive(out / name, out.parent / ".resume" / f"{out.name}-{name}"):
        return _evaluate(name, train, graphs, labels, out, load(Evaluate, params))


def _evaluate(name: str, train: Path, graphs: Path, labels: Path, out: Path, settings: Evaluate) -> Path:
    config = store.read_json(train / name / "config.json", stage=f"train@{name}", form=runs.Config)
    line, seeds = config["model"], config["seeds"]
    variant = graphs / line["input"]
    folds = runs.drop_untestable(runs.folds(store.read_index(variant, stage="graphs"), line), variant, labels, line)
    models = {run: _load(run, name, config) for run in runs.runs(train / name, seeds, folds)}

    # Once each, though several folds may have been fitted to a drive: its frames count once in errors and intervals.
    cases: dict[str, dict[str, split.Case]] = {of: {} for of in SPLITS}
    for fold in folds:
        of_fold = [model for run, model in models.items() if run.fold == fold]
        for of, known in cases.items():
            for drive in (drive for drive in getattr(fold, of) if drive not in known):
                read = windows.read_drive(variant, labels, drive, line["horizon"], line["motion"])
                known[drive] = split.Case(read, _predict(of_fold, read), of_fold[0].target.mean_rad)
    of_splits = {of: list(known.values()) for of, known in cases.items()}

    result: dict[str, Any] = {
        "model": name,
        "line": line,
        "seeds": seeds,
        "drives": {of: list(known) for of, known in cases.items()},
        "parameters": config["parameters"],
        "wheelbase_m": of_splits["test"][0].drive.car.wheelbase_m,
        "path": settings.path,
        "variant": split.variant(of_splits["test"][0].drive),
        **split.sizes([case.drive for case in of_splits["test"]]),
        **{of: split.figures(of_split, settings) if of_split else None for of, of_split in of_splits.items()},
    }
    store.write_json(out / name / "metrics.json", result)
    for number, folder in enumerate(runs.folders(out / name, seeds).values()):
        rows = [(case.drive, case.predicted[number]) for case in of_splits["test"]]
        predictions.write(folder / "predictions.csv", rows)
    tested = [case.drive for case in of_splits["test"]]
    structure.write(out / name / "structure.json", tested)
    # With folds, of the first one's network on the drive that it has not seen.
    first, model = next(iter(models.items()))
    neurons.write(out / name / "neurons.json", model, tested if first.fold.name is None else tested[:1])
    _draw_and_say(out / name / "steering.png", result, of_splits["test"])
    return out / name


def _load(run: runs.Run, name: str, config: Mapping[str, Any]) -> predict.Trained:
    model = predict.load(run.folder)
    if (model.name, model.line, model.seed, model.fold) != (name, config["model"], run.seed, run.fold.name):
        raise InputError(
            f"{run.folder / 'best.pt'} is of model {model.name}, seed {model.seed}, and not what config.json "
            f"says. Train it again: dvc repro --force --single-item train@{name}"
        )
    return model


def _predict(models: list[predict.Trained], drive: windows.Drive) -> np.ndarray:
    """Return what each of the models predicts, [S,G] rad."""
    with frames.open_graphs(drive.graphs) as graphs:
        return np.stack([model.predict(graphs) for model in models])


def _draw_and_say(path: Path, result: Mapping[str, Any], tested: list[split.Case]) -> None:
    """Draw the test drives with one seed's predictions, and print the test's figures."""
    name, test, count = result["model"], result["test"], len(result["seeds"])
    steering_plot.draw(
        path,
        [(case.drive, case.predicted[0]) for case in tested],
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
