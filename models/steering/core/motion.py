"""What a car did since the frame before, as the recurrent network hears it."""

import torch
from torch import Tensor

ODD, EVEN = slice(0, 2), slice(2, 4)
"""Columns of `motion`: measured angle (rad) and yaw rate (rad/s), both left +; speed (m/s) and valid (0 or 1)."""
COLUMNS = 4
# What counts as much: of the odd columns a sharp corner, of the even ones a fast street.
ODD_REACH = (0.25, 0.4)  # rad, rad/s
EVEN_REACH = (15.0, 1.0)  # m/s, 1


def odd_and_even(motion: Tensor) -> tuple[Tensor, Tensor]:
    """Split motion [B,4] into what changes its sign in a mirror and what does not, each [B,2] and O(1).

    A measurement far beyond a sharp corner is none: the odd columns end at ±1.
    """
    odd = torch.tanh(motion[:, ODD] / motion.new_tensor(ODD_REACH))
    return odd, motion[:, EVEN] / motion.new_tensor(EVEN_REACH)
