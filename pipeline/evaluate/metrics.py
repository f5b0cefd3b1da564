"""Compute the metrics of one split, column by column, for metrics.json; and write predictions.csv."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.evaluate import errors
from pipeline.evaluate.turns import Track, Turns, drift, near_onsets, read_turns
from pipeline.graphs.graph_file import open_graphs
from pipeline.labels import label
from pipeline.settings.evaluate import Evaluate
from pipeline.train.loss import Prediction, Scale
from pipeline.train.targets import LabelledDrive


@dataclass(frozen=True)
class Case:
    """A drive with the predictions of a model's S seeds for its G frames in R columns."""

    drive: LabelledDrive
    predictions: Sequence[Prediction]  # [S]
    scale: Scale

    @cached_property
    def turns(self) -> Turns:
        """The onsets of turns in the drive."""
        return read_turns(self.drive)

    def baselines(self) -> dict[str, np.ndarray]:
        """Return the values [G,R] of predictors that do not use the scene.

        - zero: always straight ahead.
        - train_mean: the mean of the training targets.
        - persistence: the last true angle before the target frame. No model gets it as input. Not for a path, whose
          truth is in the future.
        - odometry: measured at the last input frame; 0 before the first measurement, NaN in a drive without one.
        - regression: odometry times its regression coefficient on the training drives.
        """
        drive, scale = self.drive, self.scale
        values = {"zero": np.zeros(1), "train_mean": scale.mean}
        if not drive.ahead_m:
            known = label.held(drive.driven.steering_rad, drive.driven.valid)
            shift = 0 if drive.horizon else 1
            values["persistence"] = np.concatenate([np.zeros(shift), known])[: len(known), None]
        if drive.odometry is not None:
            measured = np.isfinite(drive.odometry).any()
            values["odometry"] = np.nan_to_num(drive.odometry) if measured else drive.odometry
            if scale.odometry_gain is not None:
                values["regression"] = scale.odometry_gain * values["odometry"]
        return {name: np.broadcast_to(value, drive.target.shape) for name, value in values.items()}

    @property
    def track(self) -> Track:
        """The drive's true path, of a model that predicts the angle."""
        drive, onsets = self.drive, np.flatnonzero(np.isin(self.drive.frame, self.turns.frame))
        wheelbase_m = drive.settings["labels"]["wheelbase_m"]
        return Track(drive.time_s, drive.driven.speed_mps, drive.driven.steering_rad, onsets, wheelbase_m)


def metrics(cases: Sequence[Case], settings: Evaluate) -> dict[str, dict[str, Any]]:
    """Return column → errors with confidence interval, of frames with a valid target and a prediction."""
    parts = [_values(case) for case in cases]
    values = {name: np.concatenate([part[name] for part in parts], axis=-2) for name in parts[0]}  # [...,N,R]
    drive = np.repeat(np.arange(len(cases)), [len(case.drive.frame) for case in cases])
    result = {}
    for number, column in enumerate(cases[0].drive.columns):
        result[column] = _scores({name: array[..., number] for name, array in values.items()}, drive, settings)
        result[column]["drift_m_per_100m"] = _drift(cases)
    return result


def _values(case: Case) -> dict[str, np.ndarray]:
    """Return the truth [G,R]; predictions, σ and halves of 95 % intervals of the seeds [S,G,R]."""
    names, of_seeds = ("predicted", "sigma", "half_95"), zip(*case.predictions, strict=True)
    known = {name: np.stack(seeds) for name, seeds in zip(names, of_seeds, strict=True) if seeds[0] is not None}
    return {"truth": case.drive.target} | known


def _scores(values: dict[str, np.ndarray], drive: np.ndarray, settings: Evaluate) -> dict[str, Any]:
    """Return the metrics of a column: `values` [N] or [S,N] of all frames, and the numbers of their drives."""
    error = (values["predicted"] - values["truth"]) ** 2
    known = np.isfinite(error).all(axis=0)
    truth, predicted, *certain = (array[..., known] for array in values.values())
    return errors.scores(truth, predicted) | {
        "nmse_ci95": errors.interval(error, values["truth"], drive, settings),
        "nmse_by_seed": [errors.scores(truth, one_seed)["nmse"] for one_seed in predicted],
        "uncertainty": errors.uncertainty(truth, predicted, *certain) if certain else None,
    }


def _drift(cases: Sequence[Case]) -> float | None:
    """Return the mean over seeds of :func:`drift`; None with a horizon and for a path."""
    if cases[0].drive.horizon or cases[0].drive.ahead_m:
        return None
    tracks = [case.track for case in cases]
    by_seed = [
        drift(zip(tracks, (seed.mean[:, 0] for seed in seeds), strict=True))
        for seeds in zip(*(case.predictions for case in cases), strict=True)
    ]
    values = [value for value in by_seed if value is not None]
    return float(np.mean(values)) if values else None


def columns(cases: Sequence[Case]) -> dict[str, dict[str, Any]]:
    """Return column → unit and range in metres."""
    ranges: list[Any] = [*pairwise(cases[0].drive.ahead_m)] or [(None, None)]
    unit = "1/m" if cases[0].drive.ahead_m else "rad"
    return {
        name: {"unit": unit, "from_m": near, "to_m": far}
        for name, (near, far) in zip(cases[0].drive.columns, ranges, strict=True)
    }


def inputs(drives: Sequence[LabelledDrive]) -> dict[str, Any]:
    """Return settings of the drives' graph variant, and means per frame; None where a file has none.

    Means are of points, and of directed kNN edges after and before pruning.
    """
    counts: dict[str, list[np.ndarray]] = {"points": [], "edges_knn": [], "edges_kept": []}
    for drive in drives:
        with open_graphs(drive.graphs) as graphs:
            for name, values in graphs.counts.items():
                counts[name].append(values)
    points, knn, edges = (float(np.concatenate(parts).mean()) if parts else None for parts in counts.values())
    sizes = {"points_per_frame": points, "edges_per_frame": edges, "edges_per_frame_unpruned": knn}
    return {"variant": drives[-1].settings.get("graphs", {}), **sizes}


def write_predictions(path: Path, cases: Sequence[Case], seed: int) -> None:
    """Write one row per frame with the predictions of seed number `seed`; unknown values are empty fields.

    `frame`, `time_s` and `speed_mps` belong to the last input frame. For each column C of the model, `true_C` and
    `predicted_C` are those `horizon` frames later. Further columns are the :meth:`Case.baselines` without zero, for
    instance `odometry_C`, empty before the first measurement; `near_onset_C`, 1 close to the onset of a turn
    (turns.py); `sigma_C` of models with uncertainty.
    """
    tables = []
    for case in cases:
        drive, (mean, sigma, _) = case.drive, case.predictions[seed]
        values = {"true": drive.target, "predicted": mean, **case.baselines()}
        del values["zero"]
        if drive.odometry is not None:
            values["odometry"] = np.broadcast_to(drive.odometry, mean.shape)
        values["near_onset"] = near_onsets(drive, case.turns).astype(int)
        if sigma is not None:
            values["sigma"] = sigma
        table = {"drive": drive.name, "frame": drive.frame, "time_s": drive.time_s, "speed_mps": drive.driven.speed_mps}
        for (number, name), (kind, of) in product(enumerate(drive.columns), values.items()):
            table[f"{kind}_{name}"] = of[:, number]
        tables.append(pd.DataFrame(table))
    path.parent.mkdir(parents=True, exist_ok=True)
    pd.concat(tables).to_csv(path, index=False, lineterminator="\n", float_format="%.9f")
