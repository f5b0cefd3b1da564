"""Find the road's horizon by the essential matrices of pairs of images."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from pipeline.base.errors import InputError
from pipeline.camera.camera import Camera
from pipeline.camera.geometry import project
from pipeline.camera.images import Size
from pipeline.motion.odometry import measure_quality, pick_corners, track_corners
from pipeline.motion.triangulation import pixel_rays

# Width in pixels of the images that are tracked.
WIDTH = 640
# Width in pixels of the cells that give corners.
CELL_PX = 24
# Least quality of a corner, see :func:`pipeline.motion.odometry.measure_quality`.
MIN_QUALITY = 2e-5
# Least number of tracked corners of a pair of images.
MIN_TRACKS = 60
# Least share of the tracked corners that agree with the motion.
MIN_INLIERS = 0.4
# Least median motion in pixels of the corners: below, the direction of travel is noise.
MIN_FLOW_PX = 1.0
# Largest distance in pixels of an inlier from its epipolar line.
RANSAC_PX = 0.7
# Least forward component of a car's direction of travel, a unit vector.
MIN_FORWARD = 0.9

# Largest number of pairs from which the horizon is found.
PAIRS = 60
# Number of images between the beginnings of these pairs.
PAIR_EVERY = 10
# Least number of pairs that find a horizon.
MIN_PAIRS = 8
# Distance in pixels from the horizon beyond which corners count as above or below it.
MARGIN_PX = 25
# Least number of corners above, and below.
MIN_POINTS = 5
# Least number of pairs that show images upside down.
LEAST_ABOVE = 4
# Least share of these pairs where points above the horizon are nearer, if images are upside down.
# In six real recordings, it is up to 12 %; turned by 180°, 86 % and more.
OPPOSITE = 0.8


class _Motion(NamedTuple):
    """The motion between two images, and N points that agree with it.

    Rotation and translation take points to the later camera.
    """

    rotation: np.ndarray  # [3,3]
    translation: np.ndarray  # [3], of unknown length
    K: np.ndarray  # of images with WIDTH
    uv: np.ndarray  # pixels in the earlier image [N,2]
    uv_now: np.ndarray  # pixels in the later image [N,2]


class _Heading(NamedTuple):
    """What a pair of images says about the horizon."""

    row: float  # of the focus of expansion
    nearer_above: bool | None  # whether points above it are nearer than those below; None: unknown


class HeadingFinder:
    """Find the headings of consecutive images of a car's camera, which are added one by one."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._before = np.zeros((0, 0, 3), np.uint8)
        self._count = 0
        self.headings = list[_Heading]()

    def add_image(self, image: np.ndarray) -> None:
        """Take the next image RGB uint8 [H,W,3]. Pairs of the first 600 images are used."""
        place = self._count % PAIR_EVERY
        if self._count < PAIRS * PAIR_EVERY and place == 0:
            self._before = image
        elif self._count < PAIRS * PAIR_EVERY and place == 1:
            motion = _measure_motion(self._before, image, self._camera)
            heading = _find_heading(motion) if motion else None
            if heading:
                self.headings.append(heading)
        self._count += 1


def compute_horizon(headings: Sequence[_Heading], camera: Camera) -> float | None:
    """Return the image row of the direction of travel; None if too few headings show one.

    It is the median over pairs of consecutive images. The row depends little on the focal length. A
    camera on a car travels along the road, so this is the road's horizon. Raises InputError if the
    images are upside down, because points above the horizon are nearer than points below it.
    """
    _check_upright(headings)
    if len(headings) < MIN_PAIRS:
        return None
    row = float(np.median([heading.row for heading in headings]))
    scale = camera.size[0] / _shrink_size(camera)[0]
    return (row + 0.5) * scale - 0.5


def _check_upright(headings: Iterable[_Heading]) -> None:
    """Raise InputError if images are upside down."""
    above = [heading.nearer_above for heading in headings if heading.nearer_above is not None]
    nearer = sum(above)
    if len(above) >= LEAST_ABOVE and nearer >= OPPOSITE * len(above):
        raise InputError(
            f"images are upside down: in {nearer} of {len(above)} pairs of images, points above "
            "the horizon are nearer than points below it",
            fix="Turn them: ffmpeg -i in.mp4 -vf hflip,vflip upright.mp4",
        )


def _find_heading(motion: _Motion) -> _Heading | None:
    """Return what a motion says about the horizon; None if it is not a car's.

    Points are compared by their nearness: the flow without the rotation, relative to the distance
    from the focus of expansion, in the middle of the image.
    """
    right, down, ahead = -motion.rotation.T @ motion.translation
    if abs(ahead) < MIN_FORWARD:
        return None
    focus = motion.K[:2, :2] @ [right / ahead, down / ahead] + motion.K[:2, 2]

    # The pixels as of a camera that does not turn.
    uv_now, _ = project(pixel_rays(motion.uv_now, motion.K) @ motion.rotation, motion.K)

    away = motion.uv - focus
    away_right, away_down = away.T
    outward = ((uv_now - motion.uv) * away).sum(axis=1)
    nearness = np.abs(outward / np.maximum((away**2).sum(axis=1), 1.0))

    # A bonnet and text do not move.
    moves = np.abs(motion.uv_now - motion.uv).max(axis=1) > MIN_FLOW_PX / 2
    middle = moves & (np.abs(away_right) < WIDTH / 4)
    above = nearness[middle & (away_down < -MARGIN_PX)]
    below = nearness[middle & (away_down > MARGIN_PX)]
    nearer_above = None
    if len(above) >= MIN_POINTS and len(below) >= MIN_POINTS:
        nearer_above = bool(np.median(above) > np.median(below))
    return _Heading(float(focus[1]), nearer_above)


def _shrink_size(camera: Camera) -> Size:
    """Return the size of the images that are tracked."""
    height, width = camera.size
    return round(height * WIDTH / width), WIDTH


def _measure_motion(before: np.ndarray, now: np.ndarray, camera: Camera) -> _Motion | None:
    """Return the motion between two images RGB uint8 [H,W,3]; None if it cannot be measured."""
    size = _shrink_size(camera)
    grey_before = _shrink_image(before, size)
    grey_now = _shrink_image(now, size)
    K = camera.scaled(size).K

    # Follow corners from image to image.
    uv = pick_corners(measure_quality(grey_before), CELL_PX, MIN_QUALITY)
    uv_now, tracked = track_corners(grey_before, grey_now, uv, uv)
    uv = uv[tracked].astype(np.float64)
    uv_now = uv_now[tracked].astype(np.float64)
    if len(uv) < MIN_TRACKS or np.median(np.abs(uv_now - uv).max(axis=1)) < MIN_FLOW_PX:
        return None

    # RANSAC separates the static street from moving objects.
    essential, inliers = cv2.findEssentialMat(uv, uv_now, K, cv2.RANSAC, 0.999, RANSAC_PX)
    if essential is None or essential.shape != (3, 3) or inliers.mean() < MIN_INLIERS:
        return None
    agree = inliers[:, 0] > 0
    _, rotation, translation, _ = cv2.recoverPose(essential, uv, uv_now, K, mask=inliers)
    return _Motion(rotation, translation[:, 0], K, uv[agree], uv_now[agree])


def _shrink_image(image: np.ndarray, size: Size) -> np.ndarray:
    """Return a grey image of a size (H, W)."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return cv2.resize(grey, size[::-1], interpolation=cv2.INTER_AREA)
