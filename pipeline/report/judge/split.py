"""Compute the metrics of one split, as written to metrics.json."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.report.judge import certainty, decisions, errors, paths
from pipeline.report.judge.interval import nmse_interval, nmse_std
from pipeline.sections.evaluate import Evaluate
from pipeline.train.predict import Prediction
from pipeline.train.windows import Drive


@dataclass(frozen=True)
class Case:
    """A drive with the predictions of a model's S seeds for its G frames."""

    drive: Drive
    predictions: Sequence[Prediction]  # [S]
    train_mean_rad: float

    @property
    def counted(self) -> np.ndarray:
        """Return the frames [G] with a valid target and a prediction, bool."""
        return self.drive.valid & ~np.isnan(self.predictions[0].steering_rad)


def metrics(cases: Sequence[Case], settings: Evaluate) -> dict[str, Any]:
    """Return errors, confidence interval, baselines, and errors by curvature, by drive and without decisions.

    `without_decisions` leaves out the frames of :func:`decisions.near`.
    """
    columns = _Columns(cases)
    steering, predicted = columns.steering, columns.predicted
    interval = nmse_interval(
        steering, predicted, columns.number, settings.bootstrap_block_frames, settings.bootstrap_samples, settings.seed
    )
    names = [case.drive.name for case in cases]
    row_names = np.array(names)[columns.number]
    return columns.scores() | {
        "nmse_std": nmse_std(steering, predicted),
        "nmse_ci95": list(interval),
        "by_curvature": errors.by_curvature(steering, predicted, columns.curvature, settings.curvature_bins_1pm),
        "by_drive": {name: columns.scores(row_names == name) for name in dict.fromkeys(names)},
        "without_decisions": columns.scores(~columns.near),
        "drift_m_per_100m": _drift(cases, settings),
        "uncertainty": None
        if columns.sigma is None
        else certainty.scores(columns.steering, columns.predicted, columns.sigma),
    }


def _drift(cases: Sequence[Case], settings: Evaluate) -> float | None:
    """Return the mean over seeds of :func:`paths.drift`; None with a horizon."""
    if any(case.drive.horizon for case in cases):
        return None
    tracks = [_track(case.drive, settings) for case in cases]
    by_seed = [
        paths.drift([(track, case.predictions[seed].steering_rad) for track, case in zip(tracks, cases, strict=True)])
        for seed in range(len(cases[0].predictions))
    ]
    values = [value for value in by_seed if value is not None]
    return float(np.mean(values)) if values else None


def _track(drive: Drive, settings: Evaluate) -> paths.Track:
    return paths.Track(
        time_s=drive.time_s,
        speed_mps=drive.speed_mps,
        steering_rad=np.nan_to_num(drive.steering_rad),
        onsets=np.flatnonzero(np.isin(drive.frame, decisions.frames(drive))),
        wheelbase_m=drive.car.wheelbase_m,
        formula=settings.path,
    )


class _Columns:
    """The counted frames of all cases, N together."""

    def __init__(self, cases: Sequence[Case]) -> None:
        def column(arrays: Sequence[np.ndarray]) -> np.ndarray:
            return np.concatenate([values[case.counted] for values, case in zip(arrays, cases, strict=True)])

        drives = [case.drive for case in cases]
        self.steering = column([drive.steering_rad for drive in drives])
        by_seed = list(zip(*(case.predictions for case in cases), strict=True))
        self.predicted = np.stack([column([each.steering_rad for each in one_seed]) for one_seed in by_seed])  # [S,N]
        sigma = [[each.sigma_rad for each in one_seed if each.sigma_rad is not None] for one_seed in by_seed]
        self.sigma = np.stack([column(one_seed) for one_seed in sigma]) if all(sigma) else None  # [S,N]
        self.curvature = column([drive.curvature_1pm for drive in drives])
        self.near = column([decisions.near(drive) for drive in drives])
        self.number = column([np.full(len(drive.frame), index) for index, drive in enumerate(drives)])
        self._mean = column([np.full(len(case.drive.frame), case.train_mean_rad) for case in cases])
        self._persistence = column([drive.persistence_rad for drive in drives])
        kinds = [kind for kind in drives[0].measured_rad if all(kind in drive.measured_rad for drive in drives)]
        self._measured = {kind: column([drive.measured_rad[kind] for drive in drives]) for kind in kinds}

    def scores(self, rows: np.ndarray | slice = slice(None)) -> dict[str, Any]:
        """Return the scores of some rows, and of the baselines on them."""
        steering, measured = self.steering[rows], {kind: angle[rows] for kind, angle in self._measured.items()}
        return errors.scores(steering, self.predicted[:, rows]) | {
            "baselines": errors.baselines(steering, self._mean[rows], self._persistence[rows], measured)
        }


def variant(drive: Drive) -> dict[str, Any]:
    """Return the settings of the graph variant of a drive's graph file."""
    with store.DriveReader(drive.graphs, stage="graphs") as file:
        settings: dict[str, Any] = file.params.get("graphs", {})
    return settings


def sizes(drives: Sequence[Drive]) -> dict[str, float | None]:
    """Return means per frame: points, directed kNN edges after and before pruning; None where a file has none."""
    counts: dict[str, list[np.ndarray]] = {"points": [], "edges_knn": [], "edges_kept": []}
    for drive in drives:
        with store.DriveReader(drive.graphs, stage="graphs") as file:
            if "ptr" in file:
                counts["points"].append(np.diff(file["ptr"]))
            for name in ("edges_knn", "edges_kept"):
                if name in file:
                    counts[name].append(file[name])
    points, knn, edges = (float(np.concatenate(parts).mean()) if parts else None for parts in counts.values())
    return {"points_per_frame": points, "edges_per_frame": edges, "edges_per_frame_unpruned": knn}
