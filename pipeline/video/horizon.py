"""Find the horizon's row in a moving camera's images: that of the focus of expansion on straight drives."""

from collections.abc import Iterable
from itertools import islice, pairwise

import numpy as np

from pipeline.camera.camera import Camera, Frame
from pipeline.motion.visual import Corners, track

WIDTH = 640  # px, of the images that are tracked
CELL, MIN_QUALITY = 24, 2e-5
MIN_TRACKS, MIN_INLIERS = 60, 0.4
MIN_FLOW_PX = 1.0  # below, the direction of travel is noise
RANSAC_PX = 0.7
PAIRS, PAIR_EVERY, MIN_PAIRS = 60, 10, 8


def find_horizon(frames: Iterable[Frame], camera: Camera) -> float | None:
    """Return the image row of the direction of travel; None if too few images show one.

    It is the median over pairs of consecutive images, spread over the first minute of a drive. The
    row depends little on the focal length. A camera on a car travels along the road, so this is the road's horizon.
    """
    images = (frame.image for frame in frames if frame.image is not None)
    pairs = islice(pairwise(images), 0, PAIRS * PAIR_EVERY, PAIR_EVERY)
    rows = [row for before, now in pairs if (row := _row(before, now, camera)) is not None]
    return float(np.median(rows)) if len(rows) >= MIN_PAIRS else None


def _row(before: np.ndarray, now: np.ndarray, camera: Camera) -> float | None:
    import cv2

    small = round(camera.size[0] * WIDTH / camera.size[1]), WIDTH
    first, second = (
        cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), small[::-1], interpolation=cv2.INTER_AREA)
        for image in (before, now)
    )
    K = camera.scaled(small).K
    uv = Corners(np.asarray(first)).best(np.ones(small, bool), CELL, MIN_QUALITY)
    uv_now, tracked = track(np.asarray(first), np.asarray(second), uv, uv)
    uv, uv_now = uv[tracked].astype(np.float64), uv_now[tracked].astype(np.float64)
    if len(uv) < MIN_TRACKS or np.median(np.abs(uv_now - uv).max(axis=1)) < MIN_FLOW_PX:
        return None
    essential, inliers = cv2.findEssentialMat(uv, uv_now, K, cv2.RANSAC, 0.999, RANSAC_PX)
    if essential is None or essential.shape != (3, 3) or inliers.mean() < MIN_INLIERS:
        return None
    _, rotation, translation, _ = cv2.recoverPose(essential, uv, uv_now, K, mask=inliers)
    _, down, ahead = -rotation.T @ translation[:, 0]
    if abs(ahead) < 0.9:  # of a unit vector: not a car's motion
        return None
    row = K[1, 2] + K[1, 1] * down / ahead
    return float((row + 0.5) * camera.size[0] / small[0] - 0.5)
