"""Find borders of images that no lens makes, such as the black bars of a converted video."""

import cv2
import numpy as np

from pipeline.camera.images import Crop
from pipeline.motion.horizon import MIN_QUALITY
from pipeline.motion.odometry import measure_quality

# Number of images from one that is compared to the next.
EVERY = 10
# Largest number of compared images: those of a minute at 10 images a second.
IMAGES = 60
# Least number of compared images, since a standing car's images are alike.
LEAST_IMAGES = 5
# Largest difference between the levels of a pixel in all compared images, which is ± 2.
SAME_LEVELS = 4
# Least width of a border, as a share of the image's. Narrower ones hardly change a focal length.
LEAST_SHARE = 0.01
# Width in pixels of the inner edge of a border, where the quality of a corner depends on the
# picture.
EDGE_PX = 4


class BorderFinder:
    """Find borders at two opposite edges of images that are added one by one."""

    def __init__(self) -> None:
        self._added = 0
        self._compared = 0
        # Lowest and highest level of each pixel, uint8 [H,W,3].
        self._lowest = np.zeros((0, 0, 3), np.uint8)
        self._highest = self._lowest

    def add_image(self, image: np.ndarray) -> None:
        """Take the next image RGB uint8 [H,W,3], of which every tenth is compared."""
        if self._added % EVERY == 0 and self._compared < IMAGES:
            if not self._compared:
                self._lowest = image
                self._highest = image
            self._lowest = np.minimum(self._lowest, image)
            self._highest = np.maximum(self._highest, image)
            self._compared += 1
        self._added += 1

    def find_crop(self) -> Crop | None:
        """Return what the borders leave of the images, in even numbers; None without borders.

        A border is a strip of rows or columns at an edge that are the same in all compared images
        and hold no corner. A crop cuts two opposite edges.
        """
        if self._compared < LEAST_IMAGES:
            return None
        varies = np.max(self._highest - self._lowest, axis=2) > SAME_LEVELS
        middle = self._lowest + (self._highest - self._lowest) // 2
        quality = measure_quality(cv2.cvtColor(middle, cv2.COLOR_RGB2GRAY))
        corners = np.asarray(quality > MIN_QUALITY)

        size = (len(varies), len(varies.T))
        rows = _find_picture(varies, corners)
        columns = _find_picture(varies.T, corners.T)
        crop = Crop(rows, columns, size)
        return None if crop.size == size else crop


def _find_picture(varies: np.ndarray, corners: np.ndarray) -> slice:
    """Return the rows between two borders, or all rows.

    `varies` and `corners`, bool [N,M], tell which pixels vary and are corners.
    """
    length = len(varies)
    everything = slice(0, length)
    changed = np.flatnonzero(varies.any(axis=1))
    if not len(changed):
        return everything
    start = int(changed[0])
    stop = int(changed[-1]) + 1
    if min(start, length - stop) < max(LEAST_SHARE * length, EDGE_PX + 1):
        return everything
    if corners[: start - EDGE_PX].any() or corners[stop + EDGE_PX :].any():
        return everything
    # Videos have even sizes, and FFmpeg crops at even numbers.
    start += start % 2
    return slice(start, start + (stop - start) // 2 * 2)
