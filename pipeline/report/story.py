"""Summarise the results in three sentences: how good the best model is, where it fails, and what to try next."""

import pandas as pd

from pipeline.report.results import Results, columns_below


def sentences(results: Results) -> list[str]:
    """Return the sentences about the best model of the smallest horizon; none without evaluated models."""
    models = results.models
    group = models[models["line.horizon"] == models["line.horizon"].min()] if len(models) else models
    group = group[group["test.nmse"].notna()] if len(group) else group
    if not len(group):
        return []
    best = group.loc[group["test.nmse"].astype(float).idxmin()]
    bends = _bends(best)
    return [_accuracy(best, len(group)), *([_weakness(bends)] if len(bends) > 1 else []), _next_step(best, bends)]


def _accuracy(best: pd.Series, count: int) -> str:
    among = f", the best of {count} models," if count > 1 else ""
    ahead = f" {best['line.horizon']} frames ahead" if best["line.horizon"] else ""
    text = (
        f"{best['model']}{among} predicts the steering angle{ahead} with a mean error of {best['test.mae_deg']:.1f}°; "
        f"its mean squared error is {_times(best['test.nmse'])} the error of always predicting zero"
    )
    odometry = best.get("test.baselines.odometry.nmse")
    if pd.isna(odometry) or not odometry:
        return f"{text}, and there is no odometry to compare with."
    verdict = "so it beats odometry" if best["test.nmse"] < odometry else "which needs no learning"
    return f"{text} and {_times(best['test.nmse'] / odometry)} the error of odometry, {verdict}."


def _bends(best: pd.Series) -> pd.DataFrame:
    """Return a row per range of |curvature| with frames: its name, RMSE of the best model and of zero in degrees."""
    columns = columns_below(best.dropna().index, "test.by_curvature", "rmse_deg")
    zero = "test.by_curvature.{}.baselines.zero.rmse_deg"
    rows = [(name, best[column], best[zero.format(name)]) for name, column in columns.items()]
    return pd.DataFrame(rows, columns=["range", "rmse", "zero"])


def _weakness(bends: pd.DataFrame) -> str:
    straight, sharp = bends.iloc[0], bends.iloc[-1]
    worst = "It fails in sharp bends" if bends["rmse"].idxmax() == bends.index[-1] else "In sharp bends it does well"
    steady = "wobbles" if straight["rmse"] > straight["zero"] else "is steady"
    return (
        f"{worst} (|curvature| {sharp['range']} 1/m): RMSE {sharp['rmse']:.1f}°, where always predicting zero has "
        f"{sharp['zero']:.1f}°; on straight road ({straight['range']} 1/m) it {steady}: RMSE {straight['rmse']:.1f}°, "
        f"where zero has {straight['zero']:.1f}°."
    )


def _next_step(best: pd.Series, bends: pd.DataFrame) -> str:
    steps = []
    odometry = best.get("test.baselines.odometry.nmse")
    if pd.notna(odometry) and best["line.motion"] == "none" and best["test.nmse"] > odometry:
        steps.append("motion: visual, so that the network corrects the odometry angle instead of replacing it")
    if len(bends) and bends.iloc[0]["rmse"] > bends.iloc[0]["zero"] and best["line.equivariant"] is False:
        steps.append("equivariant: true, so that a mirrored scene gives the opposite angle and a straight road no bias")
    if not steps and not best["line.horizon"]:
        steps.append("horizon: 10, a second ahead, which no odometry can measure")
    if len(steps) < 2:
        steps.append("more training drives with bends like those of the test drives (ingest.drives)")
    return f"Try next in params.yaml: {'; and '.join(steps)}."


def _times(ratio: float) -> str:
    return f"{100 * ratio:.2g} % of" if ratio < 1 else f"{ratio:.1f} times" if ratio < 10 else f"{ratio:,.0f} times"
