"""What two consecutive images say without depth, by their essential matrix: the road's horizon, and left or right."""

from collections.abc import Callable, Iterable, Iterator
from itertools import islice, pairwise

import cv2
import numpy as np

from pipeline.camera.camera import Camera, Frame
from pipeline.motion.visual import best_corners, corner_quality, track

WIDTH = 640  # px, of the images that are tracked
CELL, MIN_QUALITY = 24, 2e-5
MIN_TRACKS, MIN_INLIERS = 60, 0.4
MIN_FLOW_PX = 1.0  # below, the direction of travel is noise
RANSAC_PX = 0.7
PAIRS, PAIR_EVERY, MIN_PAIRS = 60, 10, 8
APART_S = 0.095  # of two images that are compared for a turn: the yaw of nearer ones is noise
OPPOSITE = 0.8  # least share of pairs that turn against a log whose sign is inverted


def find_horizon(frames: Iterable[Frame], camera: Camera) -> float | None:
    """Return the image row of the direction of travel; None if too few images show one.

    It is the median over pairs of consecutive images, spread over the first 600. The row depends little on the focal
    length. A camera on a car travels along the road, so this is the road's horizon.
    """
    images = (frame.image for frame in frames if frame.image is not None)
    pairs = islice(pairwise(images), 0, PAIRS * PAIR_EVERY, PAIR_EVERY)
    rows = [row for before, now in pairs if (row := _row(before, now, camera)) is not None]
    return float(np.median(rows)) if len(rows) >= MIN_PAIRS else None


def opposite_turns(
    frames: Callable[[np.ndarray], Iterator[Frame]], camera: Camera, time_s: np.ndarray, rate: np.ndarray, least: float
) -> bool:
    """Return whether images turn against a log, of `rate` [F] at `time_s` [F], left positive: OPPOSITE of the pairs.

    Up to PAIRS pairs are compared, APART_S apart, where the magnitude of `rate` is above `least`; fewer than MIN_PAIRS
    say nothing. `frames` returns those of a mask [F].
    """
    after = np.searchsorted(time_s, time_s + APART_S)
    turning = np.flatnonzero((np.abs(rate) > least) & (after < len(time_s)))
    first = turning[np.unique(np.linspace(0, len(turning) - 1, PAIRS).astype(int))] if len(turning) else turning
    used, last = np.zeros(len(time_s), bool), {int(after[row]): int(row) for row in first}
    used[first] = used[after[first]] = True
    images, agree = dict[int, np.ndarray](), list[bool]()
    for frame in frames(used):
        images[frame.number] = frame.image
        if (row := last.get(frame.number)) is not None and (motion := _motion(images[row], frame.image, camera)):
            agree.append(bool(np.sign(motion[0][0, 2]) == np.sign(rate[row])))
        for number in [number for number in images if time_s[number] < frame.time_s - 2 * APART_S]:
            del images[number]
    return len(agree) >= MIN_PAIRS and sum(agree) <= (1 - OPPOSITE) * len(agree)


def _row(before: np.ndarray, now: np.ndarray, camera: Camera) -> float | None:
    """Return the row of the direction of travel between two images; None if it cannot be measured."""
    if (motion := _motion(before, now, camera)) is None:
        return None
    rotation, translation, K = motion
    _, down, ahead = -rotation.T @ translation
    if abs(ahead) < 0.9:  # of a unit vector: not a car's motion
        return None
    row = K[1, 2] + K[1, 1] * down / ahead
    return float((row + 0.5) * camera.size[0] / _small(camera)[0] - 0.5)


def _small(camera: Camera) -> tuple[int, int]:
    return round(camera.size[0] * WIDTH / camera.size[1]), WIDTH


def _motion(before: np.ndarray, now: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return rotation [3,3] and unit translation [3] of points to the later camera, and K of the images tracked."""
    small = _small(camera)
    first, second = (
        cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), small[::-1], interpolation=cv2.INTER_AREA)
        for image in (before, now)
    )
    K = camera.scaled(small).K
    uv = best_corners(corner_quality(np.asarray(first)), CELL, MIN_QUALITY)
    uv_now, tracked = track(np.asarray(first), np.asarray(second), uv, uv)
    uv, uv_now = uv[tracked].astype(np.float64), uv_now[tracked].astype(np.float64)
    if len(uv) < MIN_TRACKS or np.median(np.abs(uv_now - uv).max(axis=1)) < MIN_FLOW_PX:
        return None
    essential, inliers = cv2.findEssentialMat(uv, uv_now, K, cv2.RANSAC, 0.999, RANSAC_PX)
    if essential is None or essential.shape != (3, 3) or inliers.mean() < MIN_INLIERS:
        return None
    _, rotation, translation, _ = cv2.recoverPose(essential, uv, uv_now, K, mask=inliers)
    return rotation, translation[:, 0], K
