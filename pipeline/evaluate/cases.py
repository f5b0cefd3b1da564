"""Predict the drives of all splits with a model, compute its errors, and write predictions.csv.

Letters: S seeds of a model, G frames of a drive, N frames of a split, R columns of the predicted
quantity.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS
from pipeline.base.store import read_index
from pipeline.evaluate import statistics
from pipeline.evaluate.drift import drift
from pipeline.evaluate.settings import Evaluate
from pipeline.graphs.graph_file import open_graphs
from pipeline.labels import label
from pipeline.train import runs
from pipeline.train.frames import Files
from pipeline.train.loss import Scale
from pipeline.train.targets import LabelledDrive, read_drive
from pipeline.train.trained import Trained

# Key of metrics.json → name of a count per frame in graph files, of which the key has the mean.
SIZES = {
    "points_per_frame": "points",
    "edges_per_frame": "edges_kept",
    "edges_per_frame_unpruned": "edges_knn",
}


@dataclass(frozen=True)
class Case:
    """A drive with the predictions of a model's S seeds for its G frames in R columns."""

    drive: LabelledDrive
    predictions: Sequence[np.ndarray]  # [S], each [G,R]
    scale: Scale

    def baselines(self) -> dict[str, np.ndarray]:
        """Return the values [G,R] of predictors that do not use the scene.

        - train_mean is the mean of the training targets.
        - persistence is the last true value before the target frame. No model gets it as an input.
          A quantity ahead of the car has none, since its truth is in the future.
        - odometry is the value that is measured at the last input frame. It is NaN before the first
          measurement.
        - regression is odometry times its regression coefficient on the training drives. Before the
          first measurement, it is 0. It is NaN if nothing is measured in the drive.
        """
        drive = self.drive
        values = {"train_mean": self.scale.mean}
        if not drive.quantity.is_ahead:
            held = [label.hold_valid(column, np.isfinite(column)) for column in drive.present.T]
            last = np.stack(held, axis=1)
            if not drive.quantity.horizon:
                # The target frame is the last input frame, so the last true value before it is that
                # of the previous frame.
                last = np.concatenate([np.zeros_like(last[:1]), last[:-1]])
            values["persistence"] = last
        if drive.odometry is not None:
            values["odometry"] = drive.odometry
            if self.scale.odometry_gain is not None:
                measured = np.nan_to_num(drive.odometry)
                if not np.isfinite(drive.odometry).any():
                    measured[:] = np.nan
                values["regression"] = self.scale.odometry_gain * measured
        return {name: np.broadcast_to(value, drive.target.shape) for name, value in values.items()}


def predict_cases(
    models: Mapping[int, Trained], variant: Path, labels: Path
) -> dict[str, list[Case]]:
    """Return split → drives with their predictions.

    `models` is seed → network. `variant` and `labels` are the folders of the graphs and of the
    labels. Raises InputError if the labels have other columns than the networks.
    """
    splits = read_index(variant, stage="graphs")
    scenes = [runs.scenes(splits, seed, model.entry.scene) for seed, model in models.items()]
    first = next(iter(models.values()))
    if first.net.device.type == "cpu":
        torch.set_num_threads(1)  # as in training: sums of more threads differ
    cases: dict[str, list[Case]] = {split: [] for split in SPLITS}
    for name, split in splits.items():
        drive = read_drive(variant, labels, name, first.entry)
        columns = drive.quantity.columns
        if columns != first.scale.names:
            problem = f"the labels have {', '.join(columns)}"
            problem += f", the trained model predicts {', '.join(first.scale.names)}"
            raise InputError(problem, drive.labels, f"Train it again: dvc repro train@{first.name}")

        # Each seed sees the scene of the drive itself, or of another drive if `scene` of the
        # model's entry says so. Each scene is loaded once, even if several seeds see it.
        scene_paths = [variant / f"{scene_of[name]}.h5" for scene_of in scenes]
        files = Files(scene_paths)
        files.load(first.net.device)
        predictions = []
        with open_graphs(drive.graphs) as graphs:
            for model, scene in zip(models.values(), scene_paths, strict=True):
                predictions.append(model.predict(graphs, scene, files))
        cases[split].append(Case(drive, predictions, first.scale))
    return cases


def evaluate_model(
    name: str, first: Trained, cases: Mapping[str, Sequence[Case]], settings: Evaluate
) -> dict[str, Any]:
    """Return the content of metrics.json, which data/README.md describes.

    `first` is the network of the model's first seed, and `cases` is split → predicted drives.
    """
    drives = {}
    for split, split_cases in cases.items():
        drives[split] = [case.drive for case in split_cases]
    tested = drives["test"]
    result: dict[str, Any] = {
        "model": name,
        "entry": first.entry.model_dump(mode="json"),
        "seeds": first.seeds,
        "drives": {},
        "turning_frames": turning_frames(drives["train"]),
        "parameters": sum(weights.numel() for weights in first.net.parameters()),
        "labels": tested[0].settings["labels"],
        **inputs(tested),
    }
    for split, split_cases in cases.items():
        with_windows = [drive for drive in drives[split] if drive.has_window(first.entry.window)]
        result["drives"][split] = [drive.name for drive in with_windows]
        result[split] = metrics(split_cases, settings) if split_cases else None
    stuck = statistics.untrained(train_nmse(result))
    result["untrained"] = [first.seeds[number] for number in stuck]
    return result


def train_nmse(result: Mapping[str, Any]) -> np.ndarray:
    """Return the nmse [S] of each seed on the training drives, as the mean over the columns."""
    by_seed = [scores["nmse_by_seed"] for scores in (result["train"] or {}).values()]
    return np.array(by_seed, float).reshape(-1, len(result["seeds"])).mean(axis=0)


def metrics(cases: Sequence[Case], settings: Evaluate) -> dict[str, dict[str, Any]]:
    """Return column → errors of the predictions for the drives of a split, with their drift."""
    drives = [case.drive for case in cases]
    # Predictions of each seed for all drives, each [G,R].
    by_seed = list(zip(*(case.predictions for case in cases), strict=True))

    # All frames of the split, one drive after the other.
    truth = np.concatenate([drive.target for drive in drives])  # [N,R]
    predicted = np.stack([np.concatenate(seed) for seed in by_seed])  # [S,N,R]
    number = np.repeat(np.arange(len(drives)), [len(drive.frame) for drive in drives])

    drift_m = _drift(drives, by_seed)
    result = {}
    for column, name in enumerate(drives[0].quantity.columns):
        errors = statistics.errors(truth[:, column], predicted[..., column], number, settings)
        result[name] = errors | {"drift_m_per_100m": drift_m}
    return result


def _drift(
    drives: Sequence[LabelledDrive], by_seed: Iterable[Iterable[np.ndarray]]
) -> float | None:
    """Return the mean drift over seeds.

    It is None for a model that predicts ahead, since only angles at the frame itself make a path
    that can drift.
    """
    quantity = drives[0].quantity
    if quantity.horizon or quantity.is_ahead:
        return None
    values = []
    for predictions in by_seed:
        angles_rad = [quantity.angle_rad(prediction) for prediction in predictions]
        value = drift(zip(drives, angles_rad, strict=True))
        if value is not None:
            values.append(value)
    return float(np.mean(values)) if values else None


def turning_frames(drives: Sequence[LabelledDrive]) -> int:
    """Return the number of frames that turn by their target, in any range of its path."""
    frames = 0
    for drive in drives:
        quantity = drive.quantity
        angle_rad = np.arctan(quantity.curvature(drive.target) * quantity.car.wheelbase_m)
        frames += int((np.abs(angle_rad) > label.TURNING_RAD).any(axis=1).sum())
    return frames


def inputs(drives: Sequence[LabelledDrive]) -> dict[str, Any]:
    """Return the graph variant's settings, and mean numbers of points and directed edges per frame.

    An unknown number is None.
    """
    result = {"variant": drives[-1].settings.get("graphs", {})}
    for key, name in SIZES.items():
        counts = [drive.counts[name] for drive in drives if name in drive.counts]
        result[key] = float(np.concatenate(counts).mean()) if counts else None
    return result


def write_predictions(path: Path, name: str, seeds: Sequence[int], cases: Sequence[Case]) -> None:
    """Write the table of the model `name`, with one row per seed and frame.

    `frame`, `time_s` and `speed_mps` are of the last input frame. For each quantity C that the
    model predicts, `true_C` and `predicted_C` are its values `horizon` frames later. Baselines have
    such columns, too, for instance `odometry_C`. Unknown values are empty fields.
    """
    tables = []
    for number, seed in enumerate(seeds):
        for case in cases:
            drive = case.drive
            table = {
                "model": name,
                "seed": seed,
                "drive": drive.name,
                "frame": drive.frame,
                "time_s": drive.time_s,
                "speed_mps": drive.driven.speed_mps,
            }
            values = {"true": drive.target, "predicted": case.predictions[number]}
            values |= case.baselines()
            for column, target in enumerate(drive.quantity.columns):
                for kind, columns_of_kind in values.items():
                    table[f"{kind}_{target}"] = columns_of_kind[:, column]
            tables.append(pd.DataFrame(table))
    pd.concat(tables).to_csv(path, index=False, lineterminator="\n", float_format="%.9f")


def summary(column: str, errors: Mapping[str, Any]) -> str:
    """Return the nmse of a column as text, with its spread over seeds and its interval."""
    if errors["nmse"] is None:
        return f"{column} unknown"
    text = statistics.nmse_text(errors["nmse"], errors["nmse_by_seed"], errors["nmse_ci95"])
    return f"{column} {text}, {errors['frames']} frames"
