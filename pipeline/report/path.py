"""The path of a car on a plane road: from curvature to places, and to the tracks of its wheels in an image."""

from collections.abc import Sequence

import numpy as np

from pipeline.camera.camera import Camera
from pipeline.camera.geometry import project

COLOURS = {"predicted": (0, 200, 60), "measured": (70, 160, 255), "driven": (255, 70, 50)}  # RGB
HALF_TRACK_M, STEP_M = 0.8, 0.5
NEAREST_M = 1.0  # drawn distance from the camera


def wheel_tracks(curvature_1pm: np.ndarray, camera: Camera, slope: float = 0.0) -> list[np.ndarray]:
    """Return the pixels (u, v) of the left and the right wheel's track, each [N,2], until they turn back.

    Args:
        curvature_1pm: of each step of STEP_M [N], left positive.
        camera: at its height over the road.
        slope: metres that the road falls per metre ahead in the camera's frame.
    """
    middle, heading_rad = follow(curvature_1pm, STEP_M)
    tracks, width = [], camera.size[1]
    for offset_m in (HALF_TRACK_M, -HALF_TRACK_M):
        wheel = middle + 1j * offset_m * np.exp(1j * heading_rad)
        down = camera.height_m + slope * wheel.real
        uv, z = project(np.stack([-wheel.imag, down, wheel.real], axis=1), camera.K)
        start = int(np.argmax(z > NEAREST_M))
        behind = np.flatnonzero(z[start:] <= NEAREST_M)  # where a path turns back
        seen = uv[start : start + behind[0] if len(behind) else None]
        tracks.append(np.clip(seen, -5 * width, 5 * width))  # OpenCV's coordinates end at 32,767
    return tracks


def follow(curvature_1pm: np.ndarray, step_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the places ahead + left i in metres, complex, and headings in rad, both [N+1], after steps of a path.

    `curvature_1pm` of each step [N], left positive.
    """
    heading_rad = np.append(0, np.cumsum(curvature_1pm * step_m))
    halfway_rad = (heading_rad[1:] + heading_rad[:-1]) / 2
    return np.append(0, np.cumsum(step_m * np.exp(1j * halfway_rad))), heading_rad


def path_steps(path_1pm: Sequence[float] | np.ndarray, ahead_m: Sequence[float], step_m: float) -> np.ndarray:
    """Return the curvature of each step [N] of a path with the mean curvature `path_1pm` [R] in ranges of edges [R+1].

    Before the first edge, the path has the curvature of the first range.
    """
    middles_m = np.arange(step_m / 2, ahead_m[-1], step_m)
    return np.asarray(path_1pm)[np.searchsorted(np.asarray(ahead_m)[1:-1], middles_m)]
