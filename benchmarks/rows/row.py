"""A row of the benchmark: ours and a peer on the same arrays, in turn, and the medians of both."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import torch

ROUNDS = 5
Measured = Callable[[], float]
"""Does the work once and returns how much of the row's unit it took, or made."""


@dataclass(frozen=True)
class Row:
    """Medians in `unit`. `ratio` says how many times as good ours is; without a peer both are None."""

    ours: float
    peer: float | None
    unit: str
    ratio: float | None
    what: str  # ours / the peer, and on what


def compare(ours: Measured, peer: Measured, unit: str, what: str, more_is_better: bool = False) -> Row:
    """Run both once to warm up, then in turn: what else the machine does meets both."""
    ours(), peer()
    turns = [(ours(), peer()) for _ in range(ROUNDS)]
    own, other = (statistics.median(figures) for figures in zip(*turns, strict=True))
    return of_medians(own, other, unit, what, more_is_better)


def alone(ours: Measured, unit: str, what: str) -> Row:
    """Run what has no peer."""
    ours()
    return Row(statistics.median(ours() for _ in range(ROUNDS)), None, unit, None, what)


def of_medians(ours: float, peer: float, unit: str, what: str, more_is_better: bool = False) -> Row:
    """Return the row of two figures that were measured elsewhere."""
    return Row(ours, peer, unit, ours / peer if more_is_better else peer / ours, what)


def ms(work: Callable[[], object], times: int = 1) -> Measured:
    """Return what takes the milliseconds of `work`; it does `times` things at once, and one of them counts."""

    def timed() -> float:
        start = time.perf_counter()
        work()
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        return 1e3 * (time.perf_counter() - start) / times

    return timed
