"""All errors of a run and their differences, data/report/results.json, as docs/results keeps them of published runs.

A key is GROUP/ROW or, of a range, GROUP/RANGE/ROW: angle-10/motion-10, path-0/10-20 m/path. A row is a model, a
baseline, or "A - B", their paired difference in nmse. val/MODEL is the validation error. Groups of some frames only, as
"path-0 winding", are those of :func:`parts`.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from pipeline.report.results import NO_LEARNING, Group

Results = dict[str, dict[str, Any]]
BEND_1PM = 0.01  # the road winds: a radius below 100 m
JUNCTION_1PM = 0.042  # a turn at a junction: 60 degrees within 25 m
REACH_M = 30.0  # within which a frame's path is looked at
TARGET = "10-20 m"
FEW_DRIVES = 10  # if there are fewer, each is a part


def results(groups: Sequence[Group], scores: dict[str, Any] | None = None) -> Results:
    """Return errors and differences of groups, validation errors, and errors of measured motion by stage scores."""
    figures = Results()
    for whole in groups:
        models = [row["model"] for row in whole.models]
        rows = [name for name in whole.predicted if name in models or name in NO_LEARNING]
        figures |= _figures(whole, rows, [*product(models, rows)])
        for group in parts(whole):
            figures |= _figures(group, rows, [*product(models, models)])
        for row in (row for row in whole.models if row["val_nmse"] < np.inf):
            known = [column["nmse_by_seed"] for column in row["val"].values() if column["nmse"] is not None]
            seeds = np.mean(known, axis=0).tolist()
            figures[f"val/{row['model']}"] = entry(row["val_nmse"], seeds=seeds, roads=len(row["drives"]["train"]))
    for kind, splits in (scores or {"motion": {}})["motion"].items():
        if splits["test"]:
            figures[f"motion/{kind}"] = entry(splits["test"]["nmse"], frames=splits["test"]["judged"])
    return figures


def parts(group: Group) -> list[Group]:
    """Return a path's group with some of its frames: by the bends of the true path ahead, and of few drives each."""
    if TARGET not in group.labels.values():
        return []
    names, masks = sorted({*group.predictions["drive"]}), frame_kinds(group)
    if 2 < len(names) < FEW_DRIVES:
        masks |= {f"of {name}": group.drive == number for number, name in enumerate(names)}
    known = {kind: np.where(mask[:, None], group.truth, np.nan) for kind, mask in masks.items()}
    return [replace(group, key=f"{group.key} {kind}", truth=truth) for kind, truth in known.items()]


def frame_kinds(group: Group) -> dict[str, np.ndarray]:
    """Return masks bool [N] of the frames, by the true mean curvature of the path's ranges.

    By the greatest one up to REACH_M: winding or straight; of the winding ones, bends of the road or turns at
    junctions. By the present one, of the first range, and that of TARGET: approach (only the second is a bend), inside
    (both), leaving (only the first).
    """
    curvature, labels = np.nan_to_num(np.abs(group.truth)), [*group.labels.values()]
    near = [number for number, label in enumerate(labels) if float(label.removesuffix(" m").split("-")[1]) <= REACH_M]
    greatest = curvature[:, near].max(axis=1)
    winding, junction = greatest > BEND_1PM, greatest > JUNCTION_1PM
    now, then = (curvature[:, labels.index(label)] > BEND_1PM for label in (labels[0], TARGET))
    return {
        "winding": winding,
        "straight": ~winding,
        "bends": winding & ~junction,
        "junctions": junction,
        "approach": then & ~now,
        "inside": then & now,
        "leaving": now & ~then,
    }


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
