"""What two consecutive images say without depth, by their essential matrix: the road's horizon, and
left or right.
"""

from collections.abc import Callable, Iterable, Iterator
from itertools import islice, pairwise
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from pipeline.base.errors import InputError, error_context
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.geometry import project
from pipeline.motion.odometry import best_corners, corner_quality, track

WIDTH = 640  # px, of the images that are tracked
CELL, MIN_QUALITY = 24, 2e-5
MIN_TRACKS, MIN_INLIERS = 60, 0.4
MIN_FLOW_PX = 1.0  # below, the direction of travel is noise
RANSAC_PX = 0.7
PAIRS, PAIR_EVERY, MIN_PAIRS = 60, 10, 8
# In six real recordings, points above the horizon are nearer in up to 12 % of the pairs; turned by
# 180°, in 86 %.
# from the horizon; on each side; pairs that tell upside down
MARGIN_PX, MIN_POINTS, LEAST_ABOVE = 25, 5, 4
TURN_PAIRS = 200  # that are compared for the yaw rate of a recording
MAX_RADPS = 1.0  # a car turns more slowly: in KITTI at up to 0.5
APART_S = 0.095  # of two images that are compared for a turn: the yaw of nearer ones is noise
OPPOSITE = 0.8  # least share of pairs that show images upside down


class _Motion(NamedTuple):
    """Between two images, of points to the later camera: rotation [3,3], and a translation [3] of
    unknown length.
    """

    rotation: np.ndarray
    translation: np.ndarray
    K: np.ndarray  # of images with WIDTH, as the points [N,2] in both
    uv: np.ndarray
    uv_now: np.ndarray


def find_horizon(frames: Iterable[Frame], camera: Camera) -> float | None:
    """Return the image row of the direction of travel; None if too few images show one.

    It is the median over pairs of consecutive images, spread over the first 600. The row depends
    little on the focal length. A camera on a car travels along the road, so this is the road's
    horizon. Raises InputError if the images are upside down, because points above the horizon are
    nearer than points below it.
    """
    images = (frame.image for frame in frames if frame.image is not None)
    pairs = islice(pairwise(images), 0, PAIRS * PAIR_EVERY, PAIR_EVERY)
    found = [
        seen
        for before, now in pairs
        if (motion := _motion(before, now, camera)) and (seen := _ahead(motion))
    ]
    above = [nearer_above for _, nearer_above in found if nearer_above is not None]
    if len(above) >= LEAST_ABOVE and sum(above) >= OPPOSITE * len(above):
        share = f"{sum(above)} of {len(above)} pairs of images"
        problem = (
            f"images are upside down: in {share}, points above the horizon are nearer than points "
            "below it"
        )
        raise InputError(problem, fix="Turn them: ffmpeg -i in.mp4 -vf hflip,vflip upright.mp4")
    if len(found) < MIN_PAIRS:
        return None
    row, scale = float(np.median([row for row, _ in found])), camera.size[0] / _small(camera)[0]
    return (row + 0.5) * scale - 0.5


def noted_horizon(
    path: Path, frames: Callable[[], Iterator[Frame]], camera: Camera, notes: list[str]
) -> float | None:
    """Return :func:`find_horizon` of the recording at `path`, and add a note about it."""
    with error_context(path):
        row = find_horizon(frames(), camera)
    found = "not found, since too few images show a drive; assuming a level camera"
    notes.append(f"horizon: {found if row is None else f'row {row:.0f} of {camera.size[0]}'}")
    return row


def _ahead(motion: _Motion) -> tuple[float, bool | None] | None:
    """Return the row of the direction of travel, and whether points above it are nearer than those
    below.

    None without a car's motion; the second is None with few points. Nearness is the flow without
    the rotation, relative to the distance from the focus of expansion, in the middle of the image.
    """
    right, down, ahead = -motion.rotation.T @ motion.translation
    if abs(ahead) < 0.9:  # of a unit vector: not a car's motion
        return None
    rays = np.linalg.solve(
        motion.K, np.column_stack([motion.uv_now, np.ones(len(motion.uv_now))]).T
    )
    uv_now = project((motion.rotation.T @ rays).T, motion.K)[0]
    focus = motion.K[:2, :2] @ [right / ahead, down / ahead] + motion.K[:2, 2]
    away = motion.uv - focus
    nearness = np.abs(
        ((uv_now - motion.uv) * away).sum(axis=1) / np.maximum((away**2).sum(axis=1), 1.0)
    )
    # unlike a bonnet, and text
    moves = np.abs(motion.uv_now - motion.uv).max(axis=1) > MIN_FLOW_PX / 2
    middle = moves & (np.abs(away[:, 0]) < WIDTH / 4)
    parts = [nearness[middle & (side * away[:, 1] > MARGIN_PX)] for side in (-1, 1)]
    known = min(map(len, parts)) >= MIN_POINTS
    return float(focus[1]), bool(np.median(parts[0]) > np.median(parts[1])) if known else None


def turn_rates(
    frames: Callable[[np.ndarray], Iterator[Frame]],
    camera: Camera,
    time_s: np.ndarray,
    within: np.ndarray,
) -> np.ndarray:
    """Return yaw rates in rad/s, left positive, [F], by the rotations between images; NaN where
    none is measured.

    Up to TURN_PAIRS pairs of the images `within` some time, bool [F], are compared, APART_S apart
    and evenly spread; a rate stands at the first image of its pair. `time_s`: [F]. `frames` returns
    the frames of a mask [F].
    """
    rates = np.full(len(time_s), np.nan)
    after = np.searchsorted(time_s, time_s + APART_S)
    possible = np.flatnonzero(within & np.append(within, False)[after])
    if not len(possible):
        return rates
    spread = np.linspace(0, len(possible) - 1, TURN_PAIRS).round().astype(int)
    first = possible[np.unique(spread)]
    first_of = {int(after[row]): int(row) for row in first}
    used = np.zeros(len(time_s), bool)
    used[first] = True
    used[after[first]] = True

    images = dict[int, np.ndarray]()
    for frame in frames(used):
        images[frame.number] = frame.image
        row = first_of.get(frame.number)
        if row is not None and row in images:
            motion = _motion(images[row], frame.image, camera)
            if motion:
                # y points down; of points, not the camera
                angle_rad = float(cv2.Rodrigues(motion.rotation)[0][1, 0])
                rate_radps = angle_rad / (time_s[frame.number] - time_s[row])
                rates[row] = rate_radps if abs(rate_radps) < MAX_RADPS else np.nan
        for number in [number for number in images if time_s[number] < frame.time_s - 2 * APART_S]:
            del images[number]
    return rates


def _small(camera: Camera) -> tuple[int, int]:
    return round(camera.size[0] * WIDTH / camera.size[1]), WIDTH


def _motion(before: np.ndarray, now: np.ndarray, camera: Camera) -> _Motion | None:
    """Return the motion between two images; None if it cannot be measured."""
    small = _small(camera)
    first, second = (
        cv2.resize(
            cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), small[::-1], interpolation=cv2.INTER_AREA
        )
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
    kept = inliers[:, 0] > 0
    _, rotation, translation, _ = cv2.recoverPose(essential, uv, uv_now, K, mask=inliers)
    return _Motion(rotation, translation[:, 0], K, uv[kept], uv_now[kept])
