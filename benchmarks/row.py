"""Measure a row of the table: this project and an alternative on the same arrays, in turn; medians count."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import torch

ROUNDS = 5
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
Measurement = Callable[[], float]
"""Do the work once and return the result in the unit of the row."""


@dataclass(frozen=True)
class Row:
    """Medians in `unit`; `ratio` above 1: this project is better by that factor. Without alternative both are None."""

    ours: float
    alternative: float | None
    unit: str
    ratio: float | None
    what: str


def compare(ours: Measurement, alternative: Measurement, unit: str, what: str) -> Row:
    """Run both once to warm up, then in turn, so that other load on the machine affects both."""
    ours(), alternative()
    results = [(ours(), alternative()) for _ in range(ROUNDS)]
    first, second = (statistics.median(column) for column in zip(*results, strict=True))
    return row(first, second, unit, what)


def row(ours: float, alternative: float, unit: str, what: str) -> Row:
    """Return the row of two results."""
    ratio = ours / alternative if unit.endswith("/s") else alternative / ours
    return Row(ours, alternative, unit, ratio, what)


def milliseconds(work: Callable[[], object], items: int = 1) -> Measurement:
    """Return a measurement of `work` in milliseconds per item, if one call processes `items`."""

    def measure() -> float:
        start = time.perf_counter()
        work()
        if DEVICE == "cuda":
            torch.cuda.synchronize()
        return 1e3 * (time.perf_counter() - start) / items

    return measure
