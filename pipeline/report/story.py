"""Summarise the results in a few sentences: how good the best model is, where it fails, and what to try next.

The 95 % intervals decide the wording: a difference that they contain is called "not shown".
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import pandas as pd

from pipeline.evaluate.errors import interval_text
from pipeline.report.results import Results, columns_below

MAX_NAMES = 3  # models named in a sentence
FACTOR, SHARE = 0.1, 0.5  # odometry is off by a factor that differs from 1 by FACTOR and leaves SHARE of its error
Verdict = Literal["better", "worse", "unclear"]
_AGAINST_ZERO: dict[Verdict, str] = {
    "better": "beats always predicting zero",
    "worse": "is worse than always predicting zero",
    "unclear": "is not shown to be better than always predicting zero",
}
_AGAINST_ODOMETRY: dict[Verdict, str] = {
    "better": "It beats {name}, which has {nmse} of the squared error of zero.",
    "worse": "It is worse than {name}, which needs no learning and has {nmse} of the squared error of zero.",
    "unclear": "It is not shown to be better than {name}, which has {nmse} of the squared error of zero.",
}
_SCALE = "the field of view (steer import --fov) and the camera's height (perception.camera_height_m)"
_SCALES = {"wheel": f"{_SCALE}, and check the steering ratio (steer import --steering-ratio)"}


def sentences(results: Results) -> list[str]:
    """Return the sentences about the best model of the smallest horizon; none without evaluated models."""
    models = results.models
    group = models[models["line.horizon"] == models["line.horizon"].min()] if len(models) else models
    group = group[group["test.nmse"].notna()] if len(group) else group
    if not len(group):
        return []
    best = group.loc[group["test.nmse"].astype(float).idxmin()]
    bends = _bends(best)
    return [
        _accuracy(best),
        *_rank(best, group),
        *_drives(best),
        *_odometry_factor(best),
        _odometry(best),
        *_by_bend(bends),
        _next_step(best, bends),
    ]


def _verdict(row: pd.Series, reference: float = 1.0, key: str = "test") -> Verdict:
    """Return whether the interval of nmse is below or above a reference; zero has 1. Unclear without an interval."""
    low, high = row[f"{key}.nmse_low"], row[f"{key}.nmse_high"]
    if pd.isna(low):
        return "unclear"
    return "better" if high < reference else "worse" if low > reference else "unclear"


def _accuracy(best: pd.Series) -> str:
    ahead = f" {best['line.horizon']} frames ahead" if best["line.horizon"] else ""
    low, high = best["test.nmse_low"], best["test.nmse_high"]
    interval = interval_text(None) if pd.isna(low) else f"95 % interval {_percent(low)} to {_percent(high)}"
    return (
        f"{best['model']} predicts the steering angle{ahead} with a mean error of {best['test.mae_deg']:.1f}° and "
        f"{_AGAINST_ZERO[_verdict(best)]}: it has {_percent(best['test.nmse'])} of the squared error of zero "
        f"({interval})."
    )


def _rank(best: pd.Series, group: pd.DataFrame) -> list[str]:
    if len(group) == 1:
        return []
    text = f"It has the lowest error of {len(group)} models"
    high = np.inf if pd.isna(best["test.nmse_high"]) else best["test.nmse_high"]
    names = [*group["model"][(group["test.nmse"] <= high) & (group["model"] != best["model"])]]
    if not names:
        return [f"{text}."]
    others = " and ".join(names) if len(names) <= MAX_NAMES else f"{len(names)} of them"
    return [f"{text}, but is not shown to be better than {others}."]


def _drives(best: pd.Series) -> list[str]:
    folds, count = best["line.fit_to"] != "train", len(best["drives.test"])
    rules = {
        "Each test drive is predicted by a network that was not fitted to it.": folds,
        "All test frames are of one drive, so the intervals say little about other roads.": count == 1,
    }
    return [text for text, holds in rules.items() if holds]


def _factor(best: pd.Series) -> float | None:
    """Return the factor that odometry is off by; None if it does not follow the angle, or its factor is near 1."""
    factor, plain, scaled = (
        best.get(key)
        for key in ("odometry.coefficient", "test.baselines.odometry.nmse", "test.baselines.regression.nmse")
    )
    if best["line.horizon"] or pd.isna(factor) or pd.isna(plain) or pd.isna(scaled):
        return None
    return float(factor) if abs(factor - 1) > FACTOR and scaled < SHARE * min(plain, 1) else None


def _odometry_factor(best: pd.Series) -> list[str]:
    factor = _factor(best)
    if factor is None:
        return []
    return [
        f"Odometry follows the angle but is off by a constant factor: it fits best multiplied by {factor:.2f} "
        f"(regression on the training drives). Set {_SCALES.get(best['labels'], _SCALE)}."
    ]


def _baseline(best: pd.Series) -> tuple[str, float | None]:
    """Return the name and nmse of the baseline of measured motion; with its factor where it is off by one."""
    factor = _factor(best)
    name, key = ("odometry", "odometry") if factor is None else (f"odometry times {factor:.2f}", "regression")
    nmse = best.get(f"test.baselines.{key}.nmse")
    return name, None if pd.isna(nmse) else float(nmse)


def _odometry(best: pd.Series) -> str:
    name, nmse = _baseline(best)
    if nmse is None:
        if best.get("labels") == "visual" and not best["line.horizon"]:
            return "The labels are measured motion themselves, so there is no odometry to compare with."
        return "There is no odometry to compare with."
    if nmse >= 1:
        return f"Odometry is no better than zero: it has {_percent(nmse)} of its squared error."
    return _AGAINST_ODOMETRY[_verdict(best, nmse)].format(name=name, nmse=_percent(nmse))


def _bends(best: pd.Series) -> pd.DataFrame:
    """Return a row per range of |curvature| with frames: its name, RMSE in degrees, that of zero, and the verdict."""
    columns = columns_below(best.dropna().index, "test.by_curvature", "rmse_deg")
    rows = []
    for name, column in columns.items():
        key = f"test.by_curvature.{name}"
        road = "on straight road" if name.startswith("0 ") else "in sharp bends" if name.startswith("≥") else "in bends"
        zero = best[f"{key}.baselines.zero.rmse_deg"]
        known = pd.notna(best.get(f"{key}.nmse_low"))  # null if every angle is 0
        rows.append((road, name, best[column], zero, _verdict(best, key=key) if known else None))
    bends = pd.DataFrame(rows, columns=["road", "range", "rmse", "zero", "verdict"])
    return bends[bends["range"] != "≥ 0"]  # one bin has no bends


def _by_bend(bends: pd.DataFrame) -> list[str]:
    """Return a sentence about the sharpest bends with frames and the straight road."""
    if not len(bends):
        return []
    parts = []
    for _, row in bends.iloc[[-1, 0] if len(bends) > 1 else [0]].iterrows():
        verdict = f"it {_AGAINST_ZERO[row['verdict']]}: " if pd.notna(row["verdict"]) else "it has "
        numbers = f"RMSE {row['rmse']:.1f}°, zero has {row['zero']:.1f}°"
        parts.append(f"{row['road']} (|curvature| {row['range']} 1/m) {verdict}{numbers}")
    text = "; ".join(parts)
    unknown = [] if _has_bends(bends) else ["The test drives have no bends, so its error there is unknown."]
    return [f"{text[0].upper()}{text[1:]}.", *unknown]


def _has_bends(bends: pd.DataFrame) -> bool:
    return bool((bends["road"] != "on straight road").any()) or not len(bends)


def _next_step(best: pd.Series, bends: pd.DataFrame) -> str:
    _, odometry = _baseline(best)
    behind = odometry is not None and odometry < 1 and _verdict(best, odometry) == "worse"
    wobbles = ((bends["road"] == "on straight road") & (bends["verdict"] == "worse")).any()
    steps: Sequence[tuple[bool, str]] = (
        (
            best["line.motion"] != "none" and best.get("line.base") == "motion" and _factor(best) is not None,
            "base: none, so that the output is not added to an angle that is off by a factor",
        ),
        (
            behind and best["line.motion"] == "none" and _factor(best) is None and pd.notna(best.get("odometry.kind")),
            f"motion: {best.get('odometry.kind')}, so that the network corrects the odometry angle instead of "
            "replacing it",
        ),
        (
            bool(wobbles) and best["line.equivariant"] is False,
            "equivariant: true, so that a mirrored scene gives the opposite angle and a straight road no bias",
        ),
        (not _has_bends(bends), "test drives with bends (ingest.drives)"),
    )
    texts = [text for holds, text in steps if holds]
    if not texts and not best["line.horizon"] and _verdict(best) == "better":
        texts.append("horizon: 10, an angle ahead of the car, which no odometry can measure")
    if len(texts) < 2:
        texts.append("more training drives with bends like those of the test drives (ingest.drives)")
    return f"Try next in params.yaml: {'; and '.join(texts)}."


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.2g} %" if ratio < 0.995 else f"{100 * ratio:,.0f} %"
