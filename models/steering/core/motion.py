"""Measured motion of the car as input of the recurrent network."""

import torch
from torch import Tensor

ODD, EVEN = slice(0, 2), slice(2, 4)
"""Columns of `motion`: measured angle (rad) and yaw rate (rad/s), both left +; speed (m/s) and valid (0 or 1)."""
COLUMNS = 4
MIRROR_SIGNS = (-1.0, -1.0, 1.0, 1.0)
"""Factor of each column under left-right mirroring."""
# Scales: a sharp corner for the odd columns, a fast street for the even ones.
ODD_SCALE = (0.25, 0.4)  # rad, rad/s
EVEN_SCALE = (15.0, 1.0)  # m/s, 1


def odd_and_even(motion: Tensor) -> tuple[Tensor, Tensor]:
    """Split motion [B,4] into the columns that change sign in the mirror and the others, each [B,2] and O(1).

    Odd columns saturate at ±1: a value far beyond a sharp corner is a measurement error.
    """
    odd = torch.tanh(motion[:, ODD] / motion.new_tensor(ODD_SCALE))
    return odd, motion[:, EVEN] / motion.new_tensor(EVEN_SCALE)
