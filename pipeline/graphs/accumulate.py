"""Clouds that span time: those of the last frames, brought into a frame's own coordinates by measured motion."""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.camera.geometry import transform
from pipeline.graphs.cloud import Cloud


def steps(motion: DriveReader, source: str) -> dict[int, np.ndarray]:
    """Return frame number → T_before_now float64 [4,4] of the frames of a motion file whose motion was measured.

    Motion by images may have corrected the depth that it knows lengths from. ``clouds/pseudo``, which are lifted from
    that depth, have not: so lengths are divided by that correction, and a street that stands still lies still, whatever
    depth's scale. `source` ``clouds/lidar`` is in metres, as motion is.
    """
    measured = motion["valid"].astype(bool)
    scale = motion["scale"] if "scale" in motion else np.ones(len(measured), np.float32)
    rows = zip(motion.frame[measured], motion["T_before"][measured], scale[measured], strict=True)
    return {int(number): of_clouds(T_before, factor, source) for number, T_before, factor in rows}


def of_clouds(T_before: np.ndarray, scale: float, source: str) -> np.ndarray:
    """Return a measured step float32 [4,4] in the lengths of the clouds of `source`, float64; see :func:`steps`.

    `scale` is what depth was multiplied by to measure it.
    """
    T = T_before.astype(np.float64)
    if source == "clouds/pseudo":
        T[:3, 3] /= scale
    return T


def accumulated(
    frame: Iterable[int], clouds: Iterable[Cloud], T_before: Mapping[int, np.ndarray], frames: int
) -> Iterator[Cloud]:
    """Yield of each frame its cloud and those of up to `frames` - 1 frames before, as it would see them now.

    `frames` is the variant's, whatever a network's window. A cloud reaches as far back as the frames follow each other
    by number and motion was measured, so not beyond a halt: there a frame's cloud is its own, since a car that stands
    is not told from one whose motion could not be measured. What moves by itself leaves a trace; what the car has
    passed lies behind the camera. At most `frames` clouds are held.

    Args:
        frame: KITTI frame numbers, ascending.
        clouds: of each its xyz [P,3] and cls [P].
        T_before: number of a frame → T_before_now, see :func:`steps`.
    """
    held: list[tuple[np.ndarray, Cloud]] = []  # T_now_then and the cloud, oldest first
    last = None
    for number, cloud in zip(frame, clouds, strict=True):
        if last is None or number != last + 1 or number not in T_before:
            held = []
        else:
            T_now_before = np.linalg.inv(T_before[number])
            held = [(T_now_before @ T_before_then, then) for T_before_then, then in held[1 - frames :]]
        held.append((np.eye(4), cloud))
        last = number
        yield (
            np.concatenate([transform(T_now_then, xyz) for T_now_then, (xyz, _) in held]).astype(np.float32),
            np.concatenate([cls for _, (_, cls) in held]),
        )
