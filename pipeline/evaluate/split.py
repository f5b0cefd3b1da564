"""Compute the metrics of one split, as written to metrics.json."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.evaluate import decisions, errors, paths
from pipeline.graphs.graph_file import open_graphs
from pipeline.settings.evaluate import Evaluate
from pipeline.train.labelled_drive import LabelledDrive


@dataclass(frozen=True)
class Case:
    """A drive with the predictions of a model's S seeds for its G frames."""

    drive: LabelledDrive
    predictions: Sequence[Any]  # [S], each a Prediction, or a PathPrediction with a PathTarget
    target: Any

    @cached_property
    def turns(self) -> decisions.Turns:
        """The onsets of turns in the drive."""
        return decisions.read_turns(self.drive)

    @property
    def onset(self) -> np.ndarray:
        """The frames [G] at which a turn begins, bool."""
        return np.isin(self.drive.frame, self.turns.frame)

    def baselines(self, kinds: Sequence[str]) -> dict[str, np.ndarray]:
        """Return the angles [G] of predictors that do not use the scene.

        - zero: always straight ahead.
        - train_mean: the mean of the training targets.
        - persistence: the last true angle before the target frame. No model gets it as input.
        - odometry: the angle measured at the last input frame, of the first of `kinds` of motion; `odometry_<kind>` for
          a second kind. NaN in a drive without measurements, for instance without scans.
        - regression: odometry times its regression coefficient on the training drives.
        """
        angles = {
            "zero": np.zeros(len(self.drive.frame)),
            "train_mean": np.full(len(self.drive.frame), self.target.mean_rad),
            "persistence": self.drive.persistence_rad,
        }
        for number, kind in enumerate(kinds):
            angles[f"odometry_{kind}" if number else "odometry"] = self.drive.measured_rad[kind]
        if kinds and kinds[0] in self.target.coefficients:
            angles["regression"] = self.target.coefficients[kinds[0]] * angles["odometry"]
        return angles

    def track(self, settings: Evaluate) -> paths.Track:
        return paths.Track(
            time_s=self.drive.time_s,
            speed_mps=self.drive.speed_mps,
            steering_rad=np.nan_to_num(self.drive.steering_rad),
            onsets=np.flatnonzero(self.onset),
            wheelbase_m=self.drive.car.wheelbase_m,
            formula=settings.path,
        )


def metrics(cases: Sequence[Case], settings: Evaluate) -> dict[str, Any]:
    """Return errors, confidence interval, baselines, and errors by curvature, by drive and without decisions.

    Only frames with a valid target and a prediction are scored; `without_decisions` leaves out `decisions.near_onsets`.
    """
    kinds = measured_kinds(cases)
    parts = [_scored(case, kinds) for case in cases]
    columns = {name: np.concatenate([part[name] for part in parts], axis=-1) for name in parts[0]}
    steering, predicted = columns.pop("steering"), columns.pop("predicted")  # [N], [S,N]
    curvature, certainty = columns.pop("curvature"), columns.pop("certainty", None)
    near_onset = columns.pop("near_onset")
    drive = np.repeat(np.arange(len(parts)), [len(part["steering"]) for part in parts])

    def scores(rows: np.ndarray | slice) -> dict[str, Any]:
        baselines = {name: errors.scores(steering[rows], angles[rows]) for name, angles in columns.items()}
        return errors.scores(steering[rows], predicted[:, rows]) | {"baselines": baselines}

    error = ((predicted - steering) ** 2).mean(axis=0)
    by_seed = [errors.scores(steering, one_seed)["nmse"] for one_seed in predicted]
    return scores(slice(None)) | {
        "nmse_std": float(np.std(by_seed, ddof=1)) if len(by_seed) > 1 and None not in by_seed else None,
        "nmse_ci95": errors.interval(error, steering, drive, settings),
        "by_curvature": errors.by_curvature(steering, predicted, curvature, drive, settings),
        "by_drive": {case.drive.name: scores(drive == number) for number, case in enumerate(cases)},
        "without_decisions": scores(~near_onset),
        "drift_m_per_100m": _drift(cases, settings),
        "uncertainty": None if certainty is None else errors.uncertainty(steering, predicted, *certainty),
    }


def measured_kinds(cases: Sequence[Case]) -> list[str]:
    """Return the kinds of motion that all drives have; baseline odometry uses the first."""
    measured = [case.drive.measured_rad for case in cases]
    return [kind for kind in measured[0] if all(kind in kinds for kinds in measured)]


def odometry(cases: Sequence[Case]) -> dict[str, Any] | None:
    """Return the kind of motion of baseline odometry and its regression coefficient, the mean over training runs."""
    for kind in measured_kinds(cases)[:1]:
        coefficients = [case.target.coefficients[kind] for case in cases if kind in case.target.coefficients]
        return {"kind": kind, "coefficient": float(np.mean(coefficients)) if coefficients else None}
    return None


def _scored(case: Case, kinds: Sequence[str]) -> dict[str, np.ndarray]:
    """Return columns of the scored frames: arrays [N], also of baselines; predictions, σ and intervals [S,N]."""
    drive, predictions = case.drive, case.predictions
    columns = {
        "steering": drive.steering_rad,
        "predicted": np.stack([seed.steering_rad for seed in predictions]),
        "curvature": drive.curvature_1pm,
        "near_onset": decisions.near_onsets(drive, case.turns),
        **case.baselines(kinds),
    }
    spread = [(seed.sigma_rad, seed.half_95_rad) for seed in predictions if seed.sigma_rad is not None]
    if spread:
        columns["certainty"] = np.stack(spread, axis=1)  # [2,S,G]
    scored = drive.valid & ~np.isnan(predictions[0].steering_rad)
    return {name: np.compress(scored, values, axis=-1) for name, values in columns.items()}


def _drift(cases: Sequence[Case], settings: Evaluate) -> float | None:
    """Return the mean over seeds of :func:`paths.drift`; None with a horizon."""
    if cases[0].drive.horizon:
        return None
    tracks = [case.track(settings) for case in cases]
    by_seed = [
        paths.drift(zip(tracks, (seed.steering_rad for seed in seeds), strict=True))
        for seeds in zip(*(case.predictions for case in cases), strict=True)
    ]
    values = [value for value in by_seed if value is not None]
    return float(np.mean(values)) if values else None


def inputs(drives: Sequence[LabelledDrive]) -> dict[str, Any]:
    """Return settings of the drives' graph variant, and means per frame; None where a file has none.

    Means are of points, and of directed kNN edges after and before pruning.
    """
    counts: dict[str, list[np.ndarray]] = {"points": [], "edges_knn": [], "edges_kept": []}
    for drive in drives:
        with open_graphs(drive.graphs) as graphs:
            variant = graphs.params.get("graphs", {})
            for name, values in graphs.counts.items():
                counts[name].append(values)
    points, knn, edges = (float(np.concatenate(parts).mean()) if parts else None for parts in counts.values())
    sizes = {"points_per_frame": points, "edges_per_frame": edges, "edges_per_frame_unpruned": knn}
    return {"variant": variant, **sizes}
