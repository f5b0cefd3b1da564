"""How long frames take from before they are read until their angle is known."""

import time
from collections import deque
from typing import NamedTuple

import numpy as np

RECENT = 2000  # frames that the quantiles are of, so that a long run takes no more memory


class Summary(NamedTuple):
    """Quantiles of the last frames' times in ms, and how many frames a second were done."""

    p50_ms: float
    p95_ms: float
    hz: float

    def __str__(self) -> str:
        return f"{self.hz:.1f} Hz, from file to angle p50 {self.p50_ms:.0f} ms, p95 {self.p95_ms:.0f} ms"


class Latency:
    """Notes frames; the first ones, in which libraries get ready, do not count."""

    def __init__(self, warm_up: int) -> None:
        self._left, self._frames = warm_up, 0
        self._recent: deque[float] = deque(maxlen=RECENT)
        self._started_s = time.perf_counter()

    def note(self, latency_s: float) -> None:
        """Count a frame that is done now."""
        if self._left:
            self._left -= 1
            self._started_s = time.perf_counter()
            return
        self._frames += 1
        self._recent.append(latency_s)

    def summary(self) -> Summary:
        """Return what was measured so far; NaN before the first frame that counts."""
        if not self._recent:
            return Summary(float("nan"), float("nan"), float("nan"))
        p50, p95 = np.percentile(self._recent, [50, 95]) * 1e3
        return Summary(float(p50), float(p95), self._frames / (time.perf_counter() - self._started_s))
