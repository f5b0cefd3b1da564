"""Motion from images and their depth: corners, followed, lifted, and the pose that explains where they went."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from pipeline.camera import classes
from pipeline.motion.pose import pose
from pipeline.motion.step import Step
from pipeline.motion.tracks import corners, follow

MOVING = (
    classes.PERSON, classes.RIDER, classes.CAR, classes.TRUCK, classes.BUS, classes.TRAIN, classes.MOTORCYCLE,
    classes.BICYCLE,
)  # fmt: skip
MIN_WIDTH = 640  # px; smaller images are enlarged: corners are found to a fraction of a pixel, so larger ones say more
NEAREST_M, FARTHEST_M = 0.5, 80.0
EDGE = 1.3  # depths around a corner differ by this factor at most: on an edge, it is not known whose depth it has
STANDING_PX = 0.1  # half of the corners move less: the car stands


class View(NamedTuple):
    """A frame: KITTI number, image RGB uint8 [H,W,3], depth [H,W] in m with 0 = none, trainIds [H,W]."""

    number: int
    image: np.ndarray
    depth_m: np.ndarray
    cls: np.ndarray


def steps(views: Iterable[View], K: np.ndarray) -> Iterator[Step | None]:
    """Yield the motion since the frame before of each of a drive's frames, in order; None where it is not measured.

    `K` [3,3] are the intrinsics at the images' size.
    """
    before: View | None = None
    grey_before = np.empty(0, np.uint8)
    for now in views:
        grey = _grey(now.image)
        if before is None or now.number != before.number + 1:
            yield None
        else:
            yield _step(before, grey_before, grey, K)
        before, grey_before = now, grey


def _step(before: View, grey_before: np.ndarray, grey: np.ndarray, K: np.ndarray) -> Step | None:
    enlarged = len(grey) // len(before.image)
    uv_before, uv = _tracks(grey_before, grey, _usable(before), enlarged)
    if not len(uv) or np.median(np.abs(uv - uv_before).max(axis=1)) < STANDING_PX:
        return None
    column, row = np.rint(uv_before).astype(np.int64).T
    xyz = np.linalg.solve(K, np.column_stack([uv_before, np.ones(len(uv))]).T).T * before.depth_m[row, column, None]
    found = pose(xyz, uv, K)
    if found is None:
        return None
    return Step(np.linalg.inv(found.T_now_before), int(found.inliers.sum()), found.residual_px)


def _grey(image: np.ndarray) -> np.ndarray:
    """Return an image as uint8 [H,W], enlarged to at least MIN_WIDTH."""
    import cv2

    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    factor = -(-MIN_WIDTH // grey.shape[1])
    return cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC) if factor > 1 else grey


def _usable(view: View) -> np.ndarray:
    """Return where a corner's depth is known and may belong to the street, bool [H,W]."""
    import cv2

    around = np.ones((5, 5), np.uint8)
    nearest, farthest = cv2.erode(view.depth_m, around), cv2.dilate(view.depth_m, around)
    known = (nearest > NEAREST_M) & (farthest < FARTHEST_M) & (farthest < EDGE * nearest)
    moving = np.isin(view.cls, MOVING).astype(np.uint8)
    return known & (cv2.dilate(moving, around) == 0)


def _tracks(
    grey_before: np.ndarray, grey: np.ndarray, usable: np.ndarray, enlarged: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return corners of the frame before and where they are now, float64 [N,2] each, in pixels of the stored size."""
    wanted = np.repeat(np.repeat(usable, enlarged, axis=0), enlarged, axis=1)
    uv_before = corners(grey_before, wanted)
    uv, believed = follow(grey_before, grey, uv_before)
    # As geometry.scale_K: the edge of an image, not its first pixel's centre, stays where it is.
    smaller = [(pixels[believed].astype(np.float64) + 0.5) / enlarged - 0.5 for pixels in (uv_before, uv)]
    return smaller[0], smaller[1]
