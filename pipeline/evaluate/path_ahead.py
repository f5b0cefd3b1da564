"""Compute the errors of predictions of the path ahead, range by range, and write them frame by frame."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.evaluate import decisions, errors
from pipeline.evaluate.by_frame import text, write_columns
from pipeline.evaluate.split import Case, measured_kinds
from pipeline.settings.evaluate import Evaluate
from pipeline.train.path_target import PathPrediction


def range_names(ahead_m: Sequence[float]) -> list[str]:
    """Return the names of the ranges between edges, for instance 10-20."""
    return [f"{near:g}-{far:g}" for near, far in pairwise(ahead_m)]


def metrics(cases: Sequence[Case], settings: Evaluate) -> list[dict[str, Any]]:
    """Return for each range the errors of the frames with a known path and a prediction, means over the seeds.

    `nmse` is MSE / MSE of the straight path, None if every path is straight. `without_decisions` leaves out the frames
    whose path reaches the onset of a turn (:func:`decisions.near_onsets_ahead`). With uncertainty, `coverage_68` is the
    share of frames whose path is within ±σ of the prediction.
    """
    parts = [_columns(case, measured_kinds(cases)) for case in cases]
    columns = {name: np.concatenate([part[name] for part in parts], axis=-2) for name in parts[0]}  # [...,N,R]
    drive = np.repeat(np.arange(len(cases)), [len(case.drive.frame) for case in cases])
    ranges = []
    for number, (near_m, far_m) in enumerate(pairwise(cases[0].target.ahead_m)):
        of_range = {key: values[..., number] for key, values in columns.items()}
        near = of_range.pop("near_onset")
        scored = np.isfinite(of_range["true"]) & np.isfinite(of_range["predicted"][0])
        without = {"without_decisions": _scores(of_range, drive, scored & ~near, settings)}
        ranges.append({"from_m": near_m, "to_m": far_m} | _scores(of_range, drive, scored, settings) | without)
    return ranges


def _columns(case: Case, kinds: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the true and the baselines' paths [G,R], predicted paths [S,G,R], and which are near an onset [G,R].

    - held: the present measured curvature, of the first of `kinds` of motion.
    - regression: held times its regression coefficient on the training drives.
    """
    drive = case.drive
    columns = {
        "true": drive.path_1pm,
        "predicted": np.stack([seed.path_1pm for seed in case.predictions]),
        "near_onset": decisions.near_onsets_ahead(drive, case.turns),
    }
    sigmas = [seed.sigma_1pm for seed in case.predictions if seed.sigma_1pm is not None]
    if sigmas:
        columns["sigma"] = np.stack(sigmas)
    for kind in kinds[:1]:
        columns["held"] = np.repeat(drive.measured_1pm(kind)[:, None], case.target.outputs, axis=1)
        if kind in case.target.coefficients:
            columns["regression"] = columns["held"] * case.target.coefficients[kind]
    return columns


def _scores(
    columns: dict[str, np.ndarray], drive: np.ndarray, scored: np.ndarray, settings: Evaluate
) -> dict[str, Any]:
    """Return the errors of columns [...,N] in the rows that are `scored`; None without rows or bends."""
    true, predicted = (columns[name][..., scored] for name in ("true", "predicted"))
    zero = float((true**2).sum())
    if not zero:
        return {"frames": len(true), **dict.fromkeys(("nmse", "nmse_std", "nmse_ci95")), "baselines": {}}
    error = (predicted - true) ** 2  # [S,N]
    by_seed = error.sum(axis=1) / zero
    baselines = {name: columns[name][scored] for name in ("held", "regression") if name in columns}
    known = {name: values for name, values in baselines.items() if np.isfinite(values).all()}
    within = {}
    if "sigma" in columns:
        within["coverage_68"] = float((np.abs(predicted - true) <= columns["sigma"][..., scored]).mean())
    return within | {
        "frames": len(true),
        "nmse": float(by_seed.mean()),
        "nmse_std": float(by_seed.std(ddof=1)) if len(by_seed) > 1 else None,
        "nmse_ci95": errors.interval(error.mean(axis=0), true, drive[scored], settings),
        "baselines": {"zero": 1.0}
        | {name: float(((values - true) ** 2).sum() / zero) for name, values in known.items()},
    }


def write_predictions(path: Path, cases: Sequence[Case], seed: int) -> None:
    """Write one row per frame with the path that seed number `seed` predicts; unknown values are empty fields.

    `frame`, `time_s`, `speed_mps` and `onset` are as in by_frame.write_predictions, `measured_1pm` is the measured
    curvature of the first kind of motion; `driven_RANGE_1pm` and `predicted_RANGE_1pm` follow for each range, and with
    uncertainty `sigma_RANGE_1pm`.
    """
    write_columns(path, (_columns_by_frame(case, case.predictions[seed]) for case in cases))


def _columns_by_frame(case: Case, predicted: PathPrediction) -> dict[str, Iterable[Any]]:
    drive = case.drive
    kinds = [*drive.measured_rad][:1]
    columns: dict[str, Iterable[Any]] = {
        "drive": [drive.name] * len(drive.frame),
        "frame": drive.frame,
        "time_s": text(drive.time_s, 6),
        "speed_mps": text(drive.speed_mps, 4),
        "onset": case.onset.astype(int),
        "measured_1pm": text(drive.measured_1pm(kinds[0]) if kinds else np.full(len(drive.frame), np.nan), 6),
    }
    ranges = zip(range_names(drive.ahead_m), drive.path_1pm.T, predicted.path_1pm.T, strict=True)
    for name, driven_1pm, predicted_1pm in ranges:
        columns |= {f"driven_{name}_1pm": text(driven_1pm, 6), f"predicted_{name}_1pm": text(predicted_1pm, 6)}
    if predicted.sigma_1pm is not None:
        sigmas = zip(range_names(drive.ahead_m), predicted.sigma_1pm.T, strict=True)
        columns |= {f"sigma_{name}_1pm": text(sigma_1pm, 6) for name, sigma_1pm in sigmas}
    return columns
