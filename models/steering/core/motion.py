"""Columns of the measured motion [B,4], an input of networks.

A row is the motion of the car since the previous frame.
"""

import torch
from torch import Tensor

# The columns: steering angle (rad) and yaw rate (rad/s), both positive to the left; speed (m/s);
# and 1 if the motion was measured, else 0.
ANGLE, YAW_RATE, SPEED, VALID = range(4)
# Columns that change sign in the mirror image.
ODD = slice(ANGLE, SPEED)
# Columns that are the same in the mirror image.
EVEN = slice(SPEED, None)
# Scale of each column: angle and yaw rate in a sharp corner, speed on a fast street.
SCALES = (0.25, 0.4, 15.0, 1.0)


def mirrored_motion(motion: Tensor) -> Tensor:
    """Return the motion [B,4] in the mirror image."""
    return torch.cat([-motion[:, ODD], motion[:, EVEN]], dim=1)


def scaled_motion(motion: Tensor) -> Tensor:
    """Return motion [B,4] with columns of O(1).

    Angle and yaw rate are limited to ±1, because a turn much sharper than a sharp corner is an
    error of measurement.
    """
    # Columns are divided by numbers: a tensor of scales would have to be copied to a GPU in each
    # step, which blocks.
    columns = [column / scale for column, scale in zip(motion.unbind(1), SCALES, strict=True)]
    turns = torch.tanh(torch.stack(columns[ODD], dim=1))
    return torch.cat([turns, torch.stack(columns[EVEN], dim=1)], dim=1)
