"""Draw the character of the quarter that a drive crosses."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Character:
    """Dimensions and densities of a quarter's streets."""

    lane_m: float
    cruise_mps: tuple[float, float]
    kerbside: bool  # cars park at both kerbs of a street without markings; otherwise in bays beside the lanes
    pavement_m: float
    setback_m: tuple[float, float]  # of houses, behind the pavement
    storeys: tuple[int, int]
    gap_m: tuple[float, float]  # between houses
    trees: float  # probability per place, 0..1
    hedges: float
    bays: float  # probability that a side of the road has parking bays
    parked: float  # probability per place


QUARTERS = ("centre", "narrow", "suburb", "terraces", "village")


def draw_character(rng: np.random.Generator, quarter: str) -> Character:
    """Draw a quarter of one of :data:`QUARTERS`."""
    lane, pavement, parked = rng.uniform(3.1, 3.7), rng.uniform(1.8, 3.0), rng.uniform(0.5, 0.85)
    wide = (lane, (6.5, 10.0), False, pavement)
    # Parked cars leave little more room than two cars need: the ego drives close to the middle.
    narrow = (rng.uniform(2.0, 2.5), (5.0, 8.0), True, rng.uniform(1.3, 2.2))
    table = {
        "centre": Character(*wide, (0.0, 0.6), (3, 6), (0.0, 3.0), 0.3, 0.0, 0.8, parked),
        "narrow": Character(*narrow, (0.0, 3.0), (2, 4), (0.0, 6.0), 0.3, 0.5, 1.0, rng.uniform(0.55, 0.95)),
        "suburb": Character(*wide, (4.0, 9.0), (1, 3), (4.0, 12.0), 0.8, 0.6, 0.5, parked),
        "terraces": Character(*wide, (1.5, 4.0), (2, 4), (0.0, 6.0), 0.5, 0.4, 0.7, parked),
        "village": Character(*wide, (2.0, 12.0), (1, 3), (6.0, 25.0), 0.9, 0.3, 0.4, parked),
    }
    return table[quarter]
