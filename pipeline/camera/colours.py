"""Depth in colour, the same everywhere: matplotlib's Turbo on a logarithmic scale, near is red, far is blue."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

NEAR_M, FAR_M = 4.0, 80.0  # the ends of the scale; what lies beyond has their colours


def depth_scale() -> "ScalarMappable":
    """Return the scale of depth in metres: it colours arrays, and a figure can draw its bar."""
    from matplotlib.cm import ScalarMappable  # takes half a second to import
    from matplotlib.colors import LogNorm

    return ScalarMappable(LogNorm(NEAR_M, FAR_M), "turbo_r")


def colourise_depth(depth_m: np.ndarray) -> np.ndarray:
    """Return depth in metres [H,W] as uint8 RGBA [H,W,4]; where there is none (0) it is transparent black."""
    return np.asarray(depth_scale().to_rgba(np.ma.masked_equal(depth_m, 0), bytes=True))
