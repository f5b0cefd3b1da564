"""All errors of a run and their differences, data/report/results.json, as docs/results keeps them of published runs.

A key is GROUP/ROW or, of a range, GROUP/RANGE/ROW: angle-10/motion-10, path-0/10-20 m/path. A row is a model, a
baseline, or "A - B", their paired difference in nmse. val/MODEL is the validation error.
"""

import json
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from pipeline.report.results import NO_LEARNING, Group

Results = dict[str, dict[str, Any]]


def results(groups: Sequence[Group], scores: dict[str, Any] | None = None) -> Results:
    """Return errors and differences of groups, validation errors, and errors of measured motion by stage scores."""
    figures = Results()
    for group in groups:
        models = [row["model"] for row in group.models]
        rows = [name for name in group.predicted if name in models or name in NO_LEARNING]
        figures |= _figures(group, rows, [*product(models, rows)])
        for row in (row for row in group.models if row["val_nmse"] < np.inf):
            known = [column["nmse_by_seed"] for column in row["val"].values() if column["nmse"] is not None]
            seeds = np.mean(known, axis=0).tolist()
            figures[f"val/{row['model']}"] = entry(row["val_nmse"], seeds=seeds, roads=len(row["drives"]["train"]))
    for kind, splits in (scores or {"motion": {}})["motion"].items():
        if splits["test"]:
            figures[f"motion/{kind}"] = entry(splits["test"]["nmse"], frames=splits["test"]["judged"])
    return figures


def _figures(group: Group, rows: Sequence[str], pairs: Sequence[tuple[str, str]]) -> Results:
    """Return the errors of models and baselines, and the differences of pairs of them."""
    figures: Results = {}
    for column, label in group.labels.items():
        part = f"{group.key}/{label}".rstrip("/")
        for name in rows:
            scores = group.scores(name, column)
            seeds, mse, frames = scores["by_seed"], scores["mse"], scores["frames"]
            mae_deg = scores["mae"] and np.degrees(scores["mae"] * group.length_m[column])
            value, bounds = group.nmse(name, column=column)
            figures[f"{part}/{name}"] = entry(value, bounds, frames, seeds=seeds, mse=mse, mae_deg=mae_deg)
        for first, other in pairs:
            if first != other:
                value, bounds, verdict = group.difference(first, other, column)
                figures[f"{part}/{first} - {other}"] = entry(value, bounds, frames, verdict=verdict)
    return figures


def entry(
    figure: float | None, interval: list[float] | None = None, frames: int | None = None, **more: Any
) -> dict[str, Any]:
    """Return a figure with what belongs to it, numbers with five digits."""
    values = json.dumps({"figure": figure, "interval": interval, "frames": frames, **more})
    return dict(json.loads(values, parse_float=lambda text: float(f"{float(text):.5g}")))
