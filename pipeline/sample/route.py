"""The ego's path: straights and bends with clothoid transitions.

World frame: x east, y north, z up, metres; headings counter-clockwise from east. It is the path of the IMU (the rear
axle): its curvature is continuous and piecewise linear in arc length, which makes the steering label exact.
"""

from dataclasses import dataclass

import numpy as np

STEP_M = 0.1
BEHIND_M = 40.0  # road behind the first frame, for the LiDAR
AHEAD_M = 110.0  # road ahead of the last frame, for the camera
IMU_HEIGHT_M = 0.93  # of the IMU over the road
IMU_LEFT_M = 0.3  # offset of the IMU from the car's centre line, as in KITTI; the car is centred in its lane

Piece = tuple[float, float, float]
"""Length in metres, curvature in 1/m at its start and at its end."""


@dataclass(frozen=True)
class Arm:
    """A side road, from the centre of a junction outwards."""

    xy: np.ndarray  # [2] centre of the junction
    heading_rad: float
    closed: bool  # by a barrier, which shows that the route goes elsewhere
    length_m: float
    half_m: float  # half its width


@dataclass(frozen=True)
class Route:
    """The path sampled every ``STEP_M``: s [N] from -BEHIND_M, xy [N,2], heading_rad [N], curvature_1pm [N]."""

    s_m: np.ndarray
    xy: np.ndarray
    heading_rad: np.ndarray
    curvature_1pm: np.ndarray
    lane_m: float
    junctions_m: tuple[float, ...]  # s of their centres
    arms: tuple[Arm, ...]

    @property
    def right_m(self) -> float:
        """Offset of the road's right edge from the path (left is positive)."""
        return -IMU_LEFT_M - self.lane_m / 2 - 0.25

    @property
    def left_m(self) -> float:
        """Offset of the road's left edge."""
        return -IMU_LEFT_M + 1.5 * self.lane_m + 0.25

    @property
    def centre_m(self) -> float:
        """Offset of the line between the lanes."""
        return (self.left_m + self.right_m) / 2

    def at(self, s_m: np.ndarray | float, offset_m: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Return points [..., 2] at `offset_m` to the left of the path, and headings [...]."""
        heading = np.interp(s_m, self.s_m, self.heading_rad)
        xy = np.stack([np.interp(s_m, self.s_m, self.xy[:, axis]) for axis in (0, 1)], axis=-1)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        return xy + left * np.asarray(offset_m)[..., None], heading

    def curvature(self, s_m: np.ndarray) -> np.ndarray:
        """Return the curvature [...] at s_m [...]."""
        return np.interp(s_m, self.s_m, self.curvature_1pm)


def unit(heading_rad: np.ndarray | float) -> np.ndarray:
    """Return the unit vectors [..., 2] of headings [...]."""
    xy = np.empty((*np.shape(heading_rad), 2))
    xy[..., 0], xy[..., 1] = np.cos(heading_rad), np.sin(heading_rad)
    return xy


def bend(angle_rad: float, radius_m: float, transition_m: float) -> list[Piece]:
    """Return the pieces clothoid, arc, clothoid for a turn by `angle_rad` (left positive) at `radius_m`."""
    transition_m = min(transition_m, abs(angle_rad) * radius_m)  # the clothoids turn by transition / radius
    curvature = np.sign(angle_rad) / radius_m
    arc_m = abs(angle_rad) * radius_m - transition_m
    return [(transition_m, 0.0, curvature), (arc_m, curvature, curvature), (transition_m, curvature, 0.0)]


def trace(pieces: list[Piece]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return s [N], xy [N,2], heading [N], curvature [N] along `pieces`, from the origin eastwards."""
    knots = np.concatenate([[0.0], np.cumsum([piece[0] for piece in pieces])])
    s = np.arange(0, knots[-1], STEP_M)
    index = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(pieces) - 1)
    lengths, first, last = np.array(pieces).T[:, index]
    curvature = first + (last - first) * (s - knots[index]) / np.maximum(lengths, 1e-9)
    heading = np.concatenate([[0.0], np.cumsum((curvature[1:] + curvature[:-1]) / 2 * STEP_M)])
    middle = (heading[1:] + heading[:-1]) / 2
    steps = unit(middle) * STEP_M
    return s, np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]), heading, curvature
