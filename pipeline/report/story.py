"""Generate the sentences at the top of the page."""

from collections.abc import Sequence

import numpy as np

from pipeline.evaluate.errors import interval_text
from pipeline.report.results import Group


def sentences(groups: Sequence[Group], absent: Sequence[str] = ()) -> list[str]:
    """Return at most three sentences: the best model of the first group against the best baseline without learning;
    that the labels have the wrong sign; and the models that have no result here."""
    texts = []
    if groups:
        group, best = groups[0], groups[0].by_error[0]
        name, baseline = best["model"], group.best_baseline
        (nmse, interval), (difference, bounds) = group.nmse(name), group.nmse(name, minus=baseline)
        low, high = bounds or (-np.inf, np.inf)
        verdict = "shown to be better" if high < 0 else "shown to be worse" if low > 0 else "not shown to be better"
        if difference is not None:  # there is a bend in the test drives
            texts.append(
                f"{name} predicts the {group.title} with a test nmse of {nmse:.3f} ({interval_text(interval)}), "
                f"{verdict} than {baseline}, the best baseline without learning ({group.nmse(baseline)[0]:.3f}): "
                f"paired difference {difference:+.3f} ({interval_text(bounds, '+.3f')})."
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
