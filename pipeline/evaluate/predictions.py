"""Predict drives of all splits with a model, as tables of predictions.

Letters: S seeds of a model, G frames of a drive, R columns of the predicted quantity.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS
from pipeline.base.store import read_index
from pipeline.evaluate.error_table import is_turning
from pipeline.evaluate.settings import find_difference
from pipeline.graphs.graph_file import open_graphs
from pipeline.labels import label
from pipeline.motion.motion_file import open_motion, read_causal
from pipeline.train.entry import Entry
from pipeline.train.frames import Files
from pipeline.train.loss import Scale, fit_gain
from pipeline.train.targets import LabelledDrive, read_drive
from pipeline.train.trained import Trained, without_removed

# Number of training drives that are predicted. Their errors tell whether a seed failed to train.
TRAIN_DRIVES = 8
# Sections of settings that a model and the files that judge it have in common. Drives may be of
# another dataset, camera or encoder.
COMPARED = ("labels", "clouds", "graphs")
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
    odometry: np.ndarray | None  # see :func:`read_odometry`
    # Regression coefficients [R] of the targets on odometry in the training drives.
    odometry_gain: np.ndarray | None

    def predict_baselines(self) -> dict[str, np.ndarray]:
        """Return the values [G,R] of predictors that do not use the scene.

        - train_mean is the mean of the training targets.
        - persistence is the last true value up to the last input frame, or up to the frame before
          it if that is the target frame (horizon 0). Before the first true value, it is 0. No model
          gets it as an input. A quantity ahead of the car has none: its truth is in the future.
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
        if self.odometry is not None:
            values["odometry"] = self.odometry
            if self.odometry_gain is not None:
                measured = np.nan_to_num(self.odometry)
                if not np.isfinite(self.odometry).any():
                    measured[:] = np.nan
                values["regression"] = self.odometry_gain * measured
        return {name: np.broadcast_to(value, drive.target.shape) for name, value in values.items()}


def read_odometry(drive: LabelledDrive, entry: Entry) -> np.ndarray | None:
    """Return the measured values of a drive for a model's entry, [G,R].

    A frame that was not measured has the values of the last measured frame before it, or NaN if
    there is none. Returns None if the targets are of the same frames and from the same measurement,
    which they cannot judge.
    """
    if drive.are_measured and not entry.predicts_ahead:
        return None
    with open_motion(drive.motion_file) as motion:
        measured = read_causal(motion, drive.name, drive.frame)
    angle_rad = label.measured_angle(*measured, drive.quantity.car)
    return drive.quantity.measured(angle_rad)


def read_drives(
    first: Trained, variant: Path, labels: Path, motion: Path
) -> dict[str, list[LabelledDrive]]:
    """Return split → drives of a model, of which `first` is a network.

    `variant`, `labels` and `motion` are the folders of the graphs, the labels and the measured
    motion. Raises InputError if the labels have other columns than the network, or if labels or
    graphs are of other settings than those of its training.
    """
    drives: dict[str, list[LabelledDrive]] = {split: [] for split in SPLITS}
    for name, split in read_index(variant, stage="graphs").items():
        drive = read_drive(variant, labels, motion, name, first.entry)
        columns = drive.quantity.columns
        if columns != first.scale.names:
            problem = f"the labels have {', '.join(columns)}"
            problem += f", the trained model predicts {', '.join(first.scale.names)}"
            raise InputError(problem, drive.labels, f"Train it again: dvc repro train@{first.name}")
        _check_settings(first, drive)
        drives[split].append(drive)
    return drives


def _check_settings(first: Trained, drive: LabelledDrive) -> None:
    """Raise InputError if labels or graphs of a drive have other settings than in training."""
    for section in COMPARED:
        of_model = first.settings.get(section, {})
        # Files of earlier revisions may have removed keys, which checkpoints are read without.
        of_drive = without_removed(drive.settings.get(section, {}))
        key = find_difference(of_model, of_drive)
        if key is not None:
            trained = of_model.get(key, "not set")
            problem = f"{section}.{key} is {of_drive.get(key, 'not set')}"
            problem += f", but model {first.name} was trained with {trained}"
            path = drive.labels if section == "labels" else drive.graphs
            raise InputError(problem, path, f"Train it again: dvc repro train@{first.name}")


def choose_training(drives: Sequence[LabelledDrive], window: int) -> list[LabelledDrive]:
    """Return TRAIN_DRIVES of the training drives, evenly spread over those that have a window."""
    usable = [drive for drive in drives if drive.has_window(window)]
    rows = np.linspace(0, len(usable) - 1, min(TRAIN_DRIVES, len(usable)))
    return [usable[row] for row in rows.round().astype(int)]


def fit_odometry(drives: Sequence[LabelledDrive], entry: Entry) -> np.ndarray | None:
    """Return the regression coefficients [R] of targets on odometry in the training drives.

    Drives without a window, with which no network was trained, are left out. Returns None if no
    drive is left, or if :func:`read_odometry` returns None.
    """
    odometry = []
    targets = []
    for drive in drives:
        if not drive.has_window(entry.window):
            continue
        measured = read_odometry(drive, entry)
        if measured is None:
            return None
        odometry.append(measured)
        targets.append(drive.target)
    if not odometry:
        return None
    return fit_gain(np.concatenate(odometry), np.concatenate(targets))


def predict_cases(
    models: Mapping[int, Trained],
    drives: Sequence[LabelledDrive],
    odometry_gain: np.ndarray | None,
) -> list[Case]:
    """Return drives with their predictions.

    `models` is seed → network. `odometry_gain` is that of :func:`fit_odometry`.
    """
    first = next(iter(models.values()))
    if first.net.device.type == "cpu":
        torch.set_num_threads(1)  # as in training: sums of more threads differ
    cases = []
    for drive in drives:
        # All seeds share the frames, which are loaded once.
        files = Files([drive.graphs])
        files.load_frames(first.net.device)
        with open_graphs(drive.graphs) as graphs, open_motion(drive.motion_file) as measured:
            predictions = [model.predict(graphs, measured, files) for model in models.values()]
        odometry = read_odometry(drive, first.entry)
        cases.append(Case(drive, predictions, first.scale, odometry, odometry_gain))
    return cases


def prediction_table(name: str, seeds: Sequence[int], cases: Sequence[Case]) -> pd.DataFrame:
    """Return the predictions of the model `name` for some drives, a row per seed and frame.

    `frame`, `time_s` and `speed_mps` are of the last input frame. For each quantity C that the
    model predicts, `true_C` and `predicted_C` are its values `horizon` frames later. Baselines have
    such columns, too, for instance `odometry_C`. Unknown values are NaN.
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
            values |= case.predict_baselines()
            for column, target in enumerate(drive.quantity.columns):
                for kind, columns_of_kind in values.items():
                    table[f"{kind}_{target}"] = columns_of_kind[:, column]
            tables.append(pd.DataFrame(table))
    return pd.concat(tables)


def model_facts(
    name: str, first: Trained, drives: Mapping[str, Sequence[LabelledDrive]]
) -> dict[str, Any]:
    """Return what metrics.json says of a model beside its errors (data/README.md describes it).

    `first` is the network of the model's first seed, and `drives` is split → drives.
    """
    usable = {}
    for split, of_split in drives.items():
        usable[split] = [drive.name for drive in of_split if drive.has_window(first.entry.window)]
    tested = drives["test"]
    facts = {
        "model": name,
        "entry": first.entry.model_dump(mode="json"),
        "sees_frames": first.entry.network.sees_frames,
        "seeds": first.seeds,
        "drives": usable,
        "turning_frames": turning_frames(drives["train"]),
        "parameters": sum(weights.numel() for weights in first.net.parameters()),
        "labels": tested[0].settings["labels"],
        "variant": tested[0].settings.get("graphs", {}),
    }
    for key, count in SIZES.items():
        counts = [drive.counts[count] for drive in tested if count in drive.counts]
        # The variant's edges do not count for a network that reads none.
        if count.startswith("edges") and not first.entry.network.reads_edges:
            counts = []
        facts[key] = float(np.concatenate(counts).mean()) if counts else None
    return facts


def turning_frames(drives: Sequence[LabelledDrive]) -> int | None:
    """Return the number of frames whose target turns, in any of its columns.

    It is None for a quantity that does not determine a path, such as a speed.
    """
    frames = 0
    has_path = False
    for drive in drives:
        frames += int(is_turning(drive.quantity, drive.target).sum())
        has_path |= bool(np.isfinite(drive.quantity.curvature(drive.target)).any())
    return frames if has_path else None
