"""Compute the errors of a trained model on each split, beside those of the baselines: data/evaluate/<model>/."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base import console, store
from pipeline.base.errors import InputError, error_context
from pipeline.base.params import SPLITS, check_name, load
from pipeline.base.stage_folder import stage_folder
from pipeline.evaluate import by_frame, path_ahead
from pipeline.evaluate.errors import interval_text
from pipeline.evaluate.schema import Metrics, PathMetrics
from pipeline.evaluate.split import Case, inputs, metrics, odometry
from pipeline.graphs import graph_file
from pipeline.settings.evaluate import Evaluate
from pipeline.train import predict, runs
from pipeline.train.labelled_drive import read_drive


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models: in the params file")],
    train: Annotated[Path, typer.Option(help="folder with a folder for each trained model")] = Path("data/train"),
    graphs: Path = Path("data/graphs"),
    labels: Path = Path("data/labels"),
    out: Annotated[Path, typer.Option(help="the model's results go to a folder in it")] = Path("data/evaluate"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write metrics.json and, for the test drives, predictions.csv and structure.json.

    Metrics are means over the seeds and ignore invalid frames. Predictions of further seeds go to folders seed-<n>.
    With folds, each test drive is evaluated with the network that was not fitted to it, and each other drive with the
    first network that was. Returns the model's folder.
    """
    with error_context(f"MODEL {name!r}"):
        check_name(name)
    with stage_folder(f"evaluate@{name}", out / name) as folder:
        _evaluate(name, train, graphs, labels, folder.new, load(Evaluate, params))
    return out / name


def _evaluate(name: str, train: Path, graphs: Path, labels: Path, out: Path, settings: Evaluate) -> None:
    config = runs.read_config(train / name)
    entry, seeds, variant = config.model, config.seeds, graphs / config.model.input
    folds = runs.folds(store.read_index(variant, stage="graphs"), entry.fit_to, entry.roads)
    folds = runs.drop_untestable(folds, variant, labels, entry)
    models = {run: _load(run, name, config) for run in runs.runs(train / name, seeds, folds)}
    cases = _predict(models, variant, labels, config)
    tested = [case.drive for case in cases["test"]]
    path = entry.predict == "path"

    score: Any = path_ahead.metrics if path else metrics
    result: dict[str, Any] = {
        "model": name,
        "line": entry.model_dump(mode="json"),
        "seeds": seeds,
        "drives": {part: [case.drive.name for case in drives] for part, drives in cases.items()},
        "parameters": config.parameters,
        "wheelbase_m": tested[0].car.wheelbase_m,
        "labels": tested[0].label_source,
        **({} if path else {"path": settings.path, "odometry": odometry(cases["test"])}),
        **inputs(tested),
        **{part: score(drives, settings) if drives else None for part, drives in cases.items()},
    }
    form = PathMetrics if path else Metrics
    store.write_json(out / "metrics.json", form.model_validate(result).model_dump(exclude_unset=True))
    writer = path_ahead if path else by_frame
    for number, folder in enumerate(runs.folders(out, seeds).values()):
        writer.write_predictions(folder / "predictions.csv", cases["test"], number)
    by_frame.write_structure(out / "structure.json", tested)
    print(_path_summary(result) if path else _summary(result))


def _load(run: runs.Run, name: str, config: runs.Config) -> predict.Trained:
    model = predict.load(run.folder)
    if (model.name, model.entry, model.seed, model.fold) != (name, config.model, run.seed, run.fold.name):
        raise InputError(
            f"checkpoint of model {model.name}, seed {model.seed}, with other settings than config.json",
            run.folder / "best.pt",
            f"Train it again: dvc repro --force --single-item train@{name}",
        )
    return model


def _predict(
    models: Mapping[runs.Run, predict.Trained], variant: Path, labels: Path, config: runs.Config
) -> dict[str, list[Case]]:
    """Return split → drives with the predictions of all seeds; a drive of several folds once, from the first."""
    cases: dict[str, dict[str, Case]] = {part: {} for part in SPLITS}
    entry = config.model
    for fold in dict.fromkeys(run.fold for run in models):
        seeds = [model for run, model in models.items() if run.fold == fold]
        for part, drives in cases.items():
            for name in (name for name in getattr(fold, part) if name not in drives):
                drive = read_drive(variant, labels, name, **entry.reading)
                if drive.ahead_m != tuple(getattr(seeds[0].target, "ahead_m", ())):
                    problem = f"labels.ahead_m differs from the ranges of the trained model (got {drive.ahead_m})"
                    raise InputError(problem, drive.labels, f"Train it again: dvc repro train@{seeds[0].name}")
                with graph_file.open_graphs(drive.graphs) as graphs:
                    predictions = [model.predict_with_sigma(graphs) for model in seeds]
                drives[name] = Case(drive, predictions, seeds[0].target)
    return {part: list(drives.values()) for part, drives in cases.items()}


def _summary(result: Mapping[str, Any]) -> str:
    test = result["test"]
    spread = "" if test["nmse_std"] is None else f" ± {test['nmse_std']:.3f} over {len(result['seeds'])} seeds"
    return (
        f"{result['model']}: test nmse {test['nmse']:.3f}{spread} ({interval_text(test['nmse_ci95'])}), "
        f"mean error {test['mae_deg']:.2f} deg over {test['frames']} frames"
    )


def _path_summary(result: Mapping[str, Any]) -> str:
    texts = [
        f"{scores['from_m']:g}-{scores['to_m']:g} m {scores['nmse']:.3f} ({interval_text(scores['nmse_ci95'])})"
        for scores in result["test"]
        if scores["nmse"] is not None
    ]
    return f"{result['model']}: test nmse of the path ahead: {', '.join(texts) or 'no bends'}"


if __name__ == "__main__":
    console.run(main)
