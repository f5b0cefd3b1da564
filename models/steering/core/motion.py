"""Columns of the measured motion [B,4], an input of networks: the car since the previous frame."""

import torch
from torch import Tensor

# Steering angle (rad) and yaw rate (rad/s), both left positive, speed (m/s), and whether they were
# measured (0 or 1).
ANGLE, YAW_RATE, SPEED, VALID = range(4)
# Columns that change sign in the mirror image.
ODD = slice(ANGLE, SPEED)
# Columns that do not.
EVEN = slice(SPEED, None)
# Scales of the columns: a sharp corner, a fast street.
SCALES = (0.25, 0.4, 15.0, 1.0)


def mirrored_motion(motion: Tensor) -> Tensor:
    """Return the motion [B,4] in the mirror image."""
    return torch.cat([-motion[:, ODD], motion[:, EVEN]], dim=1)


def scaled_motion(motion: Tensor) -> Tensor:
    """Return motion [B,4] with columns of O(1).

    A turn far beyond a sharp corner is a measurement error, so angle and yaw rate are within ±1.
    """
    # Scales are numbers: a tensor made of them would be a blocking copy to a GPU in each step.
    columns = [column / scale for column, scale in zip(motion.unbind(1), SCALES, strict=True)]
    turns = torch.tanh(torch.stack(columns[ODD], dim=1))
    return torch.cat([turns, torch.stack(columns[EVEN], dim=1)], dim=1)
