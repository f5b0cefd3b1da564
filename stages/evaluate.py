"""Compute the errors of a trained model on each split, beside those of the baselines: data/evaluate/<model>/."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.base.outputs import stage_folder
from pipeline.base.params import SPLITS, load
from pipeline.evaluate.errors import interval_text, untrained
from pipeline.evaluate.metrics import Case, columns, inputs, metrics, turning_frames, write_predictions
from pipeline.graphs import graph_file
from pipeline.settings.evaluate import Evaluate
from pipeline.train import predict, runs
from pipeline.train.frames import Files
from pipeline.train.targets import read_drive


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models: in the params file")],
    data: Path = Path("data"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write metrics.json and, for the test drives, predictions.csv.

    Metrics are means over the seeds and ignore invalid frames. Predictions of further seeds go to folders seed-<n>.
    With folds, each test drive is evaluated with the network that was not fitted to it, and each other drive with the
    first network that was. Returns the model's folder.
    """
    settings, train, out = load(Evaluate, params), data / "train" / name, data / "evaluate" / name
    with stage_folder(f"evaluate@{name}", out) as folder:
        best = min(train.glob("fold-*/best.pt"), default=train / "best.pt")
        first = predict.load(best.parent)
        entry, variant = first.entry, data / "graphs" / first.entry.input
        folds = runs.folds(store.read_index(variant, stage="graphs"), entry)
        models = {run: predict.load(run.folder) for run in runs.runs(train, first.seeds, folds)}
        cases = _predict(models, variant, data / "labels")
        tested = [case.drive for case in cases["test"]]
        result: dict[str, Any] = {
            "model": name,
            "entry": entry.model_dump(mode="json"),
            "seeds": first.seeds,
            "drives": {
                part: [case.drive.name for case in drives if case.drive.has_window(entry.window)]
                for part, drives in cases.items()
            },
            "turning_frames": turning_frames([case.drive for case in cases["train"]]),
            "parameters": sum(weights.numel() for weights in first.net.parameters()),
            "columns": columns(tested[0]),
            **inputs(tested),
            **{part: metrics(drives, settings) if drives else None for part, drives in cases.items()},
        }
        by_seed = [scores["nmse_by_seed"] for scores in (result["train"] or {}).values()]
        trained = np.array(by_seed, float).reshape(-1, len(first.seeds)).mean(axis=0)
        result["untrained"] = [first.seeds[number] for number in untrained(trained)]
        for seed in result["untrained"]:
            error = trained[first.seeds.index(seed)]
            print(f"{name}: seed {seed} failed to train: nmse {error:.3f} on its own training drives", flush=True)
        store.write_json(folder.new / "metrics.json", result, sort_keys=False)
        for number, place in enumerate(runs.folders(folder.new, first.seeds).values()):
            write_predictions(place / "predictions.csv", cases["test"], number)
    print(f"{name}: test nmse {', '.join(_summary(*column) for column in result['test'].items())}")
    return out


def _predict(models: Mapping[runs.Run, predict.Trained], variant: Path, labels: Path) -> dict[str, list[Case]]:
    """Return split → drives with the predictions of all seeds; a drive of several folds once, from the first."""
    cases: dict[str, dict[str, Case]] = {part: {} for part in SPLITS}
    for fold in dict.fromkeys(run.fold for run in models):
        of_fold = {run.seed: model for run, model in models.items() if run.fold == fold}
        seeds = [(model, runs.scenes(fold, seed, model.entry.scene)) for seed, model in of_fold.items()]
        first = seeds[0][0]
        for part, drives in cases.items():
            for name in (name for name in getattr(fold, part) if name not in drives):
                drive = read_drive(variant, labels, name, first.entry)
                if drive.columns != first.scale.names:
                    problem = f"labels.ahead_m differs from the ranges of the trained model (got {drive.ahead_m})"
                    raise InputError(problem, drive.labels, f"Train it again: dvc repro train@{first.name}")
                seen = [variant / f"{scenes[name]}.h5" for _, scenes in seeds]
                files = Files(seen)  # for all seeds
                files.load(first.net.device)
                with graph_file.open_graphs(drive.graphs) as graphs:
                    pairs = zip(seeds, seen, strict=True)
                    predictions = [model.predict(graphs, scene, files) for (model, _), scene in pairs]
                drives[name] = Case(drive, predictions, first.scale)
    return {part: list(drives.values()) for part, drives in cases.items()}


def _summary(column: str, scores: Mapping[str, Any]) -> str:
    if scores["nmse"] is None:
        return f"{column} unknown"
    spread = f" ± {np.std(scores['nmse_by_seed'], ddof=1):.3f}" if len(scores["nmse_by_seed"]) > 1 else ""
    interval = interval_text(scores["nmse_ci95"])
    return f"{column} {scores['nmse']:.3f}{spread} ({interval}; {scores['frames']} frames)"


if __name__ == "__main__":
    console.run(main)
