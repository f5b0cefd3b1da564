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
from pipeline.train import runs, trained
from pipeline.train.frames import Files
from pipeline.train.targets import read_drive


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models: in the params file")],
    data: Path = Path("data"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write metrics.json and, for the test drives, predictions.csv.

    Metrics are means over the seeds and ignore invalid frames. Predictions of further seeds go to folders seed-<n>.
    Returns the model's folder.
    """
    settings = load(Evaluate, params)
    train = data / "train" / name
    out = data / "evaluate" / name
    with stage_folder(f"evaluate@{name}", out) as folder:
        first = trained.load(train)
        entry = first.entry
        models = {run.seed: trained.load(run.folder) for run in runs.runs(train, first.seeds)}
        cases = _predict(models, data / "graphs" / entry.input, data / "labels")
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
        train_nmse = np.array(by_seed, float).reshape(-1, len(first.seeds)).mean(axis=0)
        result["untrained"] = [first.seeds[number] for number in untrained(train_nmse)]
        for seed in result["untrained"]:
            error = train_nmse[first.seeds.index(seed)]
            print(f"{name}: seed {seed} failed to train: nmse {error:.3f} on its own training drives", flush=True)
        store.write_json(folder.new / "metrics.json", result, sort_keys=False)
        for number, run in enumerate(runs.runs(folder.new, first.seeds)):
            write_predictions(run.folder / "predictions.csv", cases["test"], number)
    print(f"{name}: test nmse {', '.join(_summary(*column) for column in result['test'].items())}")
    return out


def _predict(models: Mapping[int, trained.Trained], variant: Path, labels: Path) -> dict[str, list[Case]]:
    """Return split → drives with the predictions of the models, seed → network."""
    splits = store.read_index(variant, stage="graphs")
    scenes = [runs.scenes(splits, seed, model.entry.scene) for seed, model in models.items()]
    first = next(iter(models.values()))
    cases: dict[str, list[Case]] = {part: [] for part in SPLITS}
    for name, part in splits.items():
        drive = read_drive(variant, labels, name, first.entry)
        if drive.columns != first.scale.names:
            problem = f"labels.ahead_m differs from the ranges of the trained model (got {drive.ahead_m})"
            raise InputError(problem, drive.labels, f"Train it again: dvc repro train@{first.name}")
        seen = [variant / f"{of_seed[name]}.h5" for of_seed in scenes]
        files = Files(seen)  # for all seeds
        files.load(first.net.device)
        with graph_file.open_graphs(drive.graphs) as graphs:
            pairs = zip(models.values(), seen, strict=True)
            predictions = [model.predict(graphs, scene, files) for model, scene in pairs]
        cases[part].append(Case(drive, predictions, first.scale))
    return cases


def _summary(column: str, scores: Mapping[str, Any]) -> str:
    if scores["nmse"] is None:
        return f"{column} unknown"
    spread = f" ± {np.std(scores['nmse_by_seed'], ddof=1):.3f}" if len(scores["nmse_by_seed"]) > 1 else ""
    interval = interval_text(scores["nmse_ci95"])
    return f"{column} {scores['nmse']:.3f}{spread} ({interval}; {scores['frames']} frames)"


if __name__ == "__main__":
    console.run(main)
