"""How the car's body moves on its springs: it leans out of bends, dives when it brakes, and bumps along the road."""

from dataclasses import dataclass

import numpy as np

from pipeline.town.motion import Motion
from pipeline.town.route import Route

_LEAN_RAD_PER_MPS2, _DIVE_RAD_PER_MPS2 = 0.004, 0.003
_BUMPS_RAD, _BUMPS_M = np.deg2rad((0.03, 0.2)), (0.002, 0.012)  # least and most of a drive's standard deviation
_BUMP_M = 2.0  # half a bump's length along the road
_SPRING_FRAMES = 5  # that the body takes to follow a jump of the acceleration
_GRID_M = 0.25


@dataclass(frozen=True)
class Body:
    """Per frame [F]: roll_rad (positive: left side up), pitch_rad (positive: front down), as oxts has them, heave_m."""

    roll_rad: np.ndarray
    pitch_rad: np.ndarray
    heave_m: np.ndarray


def level(frames: int) -> Body:
    """Return a body that does not move."""
    return Body(*np.zeros((3, frames)))


def draw_body(route: Route, motion: Motion, rng: np.random.Generator) -> Body:
    """Draw the bumps of a road; a standing car does not move."""
    grid = np.arange(motion.s_m[0], motion.s_m[-1] + _GRID_M, _GRID_M)
    reach = round(3 * _BUMP_M / _GRID_M)
    kernel = np.exp(-((np.arange(-reach, reach + 1) * _GRID_M / _BUMP_M) ** 2) / 2)
    noise = rng.normal(size=(3, len(grid) + 2 * reach))
    bumps = [np.interp(motion.s_m, grid, np.convolve(row, kernel, "valid")) for row in noise]
    roll, pitch, heave = np.stack(bumps) / np.linalg.norm(kernel)
    amplitude, height = rng.uniform(*_BUMPS_RAD), rng.uniform(*_BUMPS_M)
    sideways = motion.speed_mps**2 * route.curvature(motion.s_m)
    return Body(
        roll_rad=amplitude * roll + _LEAN_RAD_PER_MPS2 * _sprung(sideways),
        pitch_rad=amplitude * pitch - _DIVE_RAD_PER_MPS2 * _sprung(motion.acceleration_mps2),
        heave_m=height * heave,
    )


def _sprung(acceleration: np.ndarray) -> np.ndarray:
    """Return the mean of the last frames' values [F]."""
    padded = np.concatenate([np.full(_SPRING_FRAMES - 1, acceleration[0]), acceleration])
    return np.convolve(padded, np.full(_SPRING_FRAMES, 1 / _SPRING_FRAMES), "valid")
