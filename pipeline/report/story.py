"""Generate the sentences at the top of the page."""

from collections.abc import Sequence

import numpy as np

from pipeline.evaluate.errors import interval_text
from pipeline.report.results import Group, Row, mean_nmse

MARGIN = 0.05  # a model whose squared error differs by less is called as good
NO_LEARNING = ("zero", "train_mean", "odometry", "regression")  # persistence repeats true angles, which no model gets


def sentences(groups: Sequence[Group], absent: Sequence[str] = ()) -> list[str]:
    """Return at most three sentences: the best model of the first group against the best row without learning; that
    the labels have the wrong sign; and the models that have no result here."""
    texts = []
    if groups and np.isfinite(mean_nmse(groups[0].by_error[0])):  # with a bend in the test drives
        group, best = groups[0], groups[0].by_error[0]
        texts.append(
            f"{best['model']} predicts the {group.title} with a test nmse of {mean_nmse(best):.3f} "
            f"({interval_text(bounds(best))}) and {_verdict(group, best)}."
        )
        gains = [column["odometry_gain"] for column in best["columns"].values()]
        if any(gain is not None and gain < 0 for gain in gains):
            texts.append("The sign of wheel_rad is inverted: left is positive.")
    if absent:
        texts.append(
            f"No result here: {', '.join(absent)}. To fetch those of another machine: dvc pull --allow-missing train "
            "evaluate, then dvc repro --pull --allow-missing"
        )
    return texts


def bounds(row: Row) -> list[float] | None:
    """Return the 95 % interval of a row's nmse; of several columns the mean of their intervals, which is too wide."""
    intervals = [scores["nmse_ci95"] for scores in row["test"].values()]
    return None if None in intervals else np.mean(intervals, axis=0).tolist()


def _verdict(group: Group, best: Row) -> str:
    reference = min((row for row in group.rows if row["model"] in NO_LEARNING), key=mean_nmse)
    nmse, ratio = mean_nmse(reference), mean_nmse(best) / mean_nmse(reference)
    name = f"{reference['model']}, the best row without learning ({nmse:.3f})"
    if ratio > 1 + MARGIN:
        return f"is worse than {name}: {ratio:.3g} times its squared error"
    if ratio > 1 - MARGIN:
        return f"is as good as {name}"
    shown = bounds(best)
    if shown and shown[1] < nmse:
        return f"beats {name}"
    return f"is not shown to be better than {name}: {ratio:.0%} of its squared error, within the 95 % interval"
