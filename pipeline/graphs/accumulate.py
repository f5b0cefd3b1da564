"""Clouds of several frames: transform the previous clouds into a frame's coordinates by measured motion."""

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.camera.geometry import transform
from pipeline.graphs.cloud import Cloud


def read_steps(motion: DriveReader, source: str) -> dict[int, np.ndarray]:
    """Return frame number → T_before_now float64 [4,4] of the valid frames of a motion file.

    It has the length unit of the clouds of `source`. Visual odometry multiplies depth by ``scale``; clouds/pseudo are
    lifted from uncorrected depth. So the step's translation is divided by the scale, and static objects coincide
    whatever the scale of depth. clouds/lidar are in metres, as motion is.
    """
    valid = motion["valid"].astype(bool)
    steps = motion["T_before"][valid].astype(np.float64)
    if source == "clouds/pseudo":
        steps[:, :3, 3] /= motion["scale"][valid, None]
    return dict(zip(motion.frame[valid].tolist(), steps, strict=True))


class Accumulator:
    """Combines each cloud with up to `frames` - 1 previous ones.

    It reaches back as long as frame numbers are consecutive and motion is valid. So it starts anew after a halt, since
    standstill looks like unmeasured motion. Moving objects leave a trace, and objects that the car has passed
    lie behind the camera.
    """

    def __init__(self, frames: int) -> None:
        self._frames = frames
        self._clouds: list[tuple[np.ndarray, Cloud]] = []  # T_now_then and the cloud, oldest first
        self._last: int | None = None

    def add(self, number: int, cloud: Cloud, T_before: np.ndarray | None) -> Cloud:
        """Return the combined cloud of the next frame, in its coordinates.

        Args:
            number: KITTI frame number, ascending.
            cloud: of the frame alone.
            T_before: the step to this frame, see :func:`read_steps`; None if it was not measured.
        """
        if self._last is None or number != self._last + 1 or T_before is None:
            self._clouds = []
        else:
            T_now_before = np.linalg.inv(T_before)
            previous = self._clouds[1 - self._frames :]
            self._clouds = [(T_now_before @ T_before_then, then) for T_before_then, then in previous]
        self._clouds.append((np.eye(4), cloud))
        self._last = number
        return (
            np.concatenate([transform(T_now_then, xyz) for T_now_then, (xyz, _) in self._clouds]).astype(np.float32),
            np.concatenate([cls for _, (_, cls) in self._clouds]),
        )
