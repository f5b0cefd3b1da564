"""Evaluated models beside each other: in which order, beside which trivial predictors, on which drives."""

from collections.abc import Sequence
from itertools import groupby
from typing import Any

from pipeline.base.params import SPLITS
from pipeline.report.tables import paper

Result = dict[str, Any]  # a model's metrics.json
BASELINES = ("zero", "train_mean", "persistence", "odometry", "odometry_lidar")
MOST_DRIVES = 6  # that a table shows one by one
KNOWABLE = "without_decisions"  # in metrics.json


def in_order(results: Sequence[Result]) -> list[Result]:
    """Return results by horizon; of each, the paper's networks in its order, then ours as they come."""
    order = [*paper.PAPER, None]
    return sorted(results, key=lambda result: (horizon(result), order.index(_of_paper(result))))


def by_horizon(results: Sequence[Result]) -> list[list[Result]]:
    """Return results that are :func:`in_order` in groups of one horizon."""
    return [list(group) for _, group in groupby(results, key=horizon)]


def horizon(result: Result) -> int:
    return result["line"].get("horizon") or 0  # older results lack it


def cell(result: Result) -> str | None:
    """Return the neuron of a network that has a choice of them."""
    line = result["line"]
    return line.get("cell") if line["temporal"] == "ncp" else None


def published(result: Result) -> paper.Published | None:
    """Return what the paper says of this network, if it is one of its own."""
    name = _of_paper(result)
    return paper.PAPER[name] if name else None


def _of_paper(result: Result) -> str | None:
    return paper.name({**result["line"], "accumulate": result.get("variant", {}).get("accumulate")})


def baselines(results: Sequence[Result]) -> dict[str, Result]:
    """Return for each trivial predictor its scores, split → as a model's, on the frames of the first model that has it.

    `results` are of one horizon.
    """
    found = {}
    for name in BASELINES:
        first = next((result for result in results if name in result["test"]["baselines"]), None)
        if first:
            found[name] = {split: first[split] and _of_baseline(first[split], name) for split in SPLITS}
    return found


def _of_baseline(scores: Result, name: str) -> Result | None:
    if name not in scores["baselines"]:
        return None
    parts = {drive: of_drive["baselines"][name] for drive, of_drive in scores.get("by_drive", {}).items()}
    knowable = scores[KNOWABLE]["baselines"][name] if KNOWABLE in scores else {}
    return {**scores["baselines"][name], "by_drive": parts, KNOWABLE: knowable}


def drives_apart(results: Sequence[Result]) -> list[str]:
    """Return the test drives if there are so few that a table can show one by one; none of one alone."""
    drives = results[0]["drives"]["test"] if results else []
    return drives if 2 <= len(drives) <= MOST_DRIVES else []


def nmse_of_drive(test: Result, drive: str) -> float | None:
    """Return the nmse on one of the test drives; None where it has none, as on a straight road."""
    return test.get("by_drive", {}).get(drive, {}).get("nmse")


def bounds(row: Result) -> str:
    """Return which |curvature| in 1/m a row of `by_curvature` is of."""
    return f"≥ {row['from_1pm']:g}" if row["to_1pm"] is None else f"{row['from_1pm']:g} to {row['to_1pm']:g}"
