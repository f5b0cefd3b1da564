"""Find what stays in place in the image while the street moves: a bonnet, text."""

import cv2
import numpy as np

from pipeline.camera.camera import Camera

GRID = slice(2, None, 4)  # rows and columns
# Sizes on the grid: of the mean around a point, of specks that are removed, and of the margin
# around places.
AROUND, SMALL, NEAR = (5, 5), np.ones((3, 3), np.uint8), np.ones((7, 7), np.uint8)
STEP = 0.1  # camera heights, a short way of a car from image to image
KEEP = 0.9  # share of the sums that remains at the next image
LEAST = 400.0  # squared grey levels; smaller expected changes are noise
STILL = 0.2  # largest ratio of changes to expected changes where nothing moves
QUANTILE, MOVES = 0.75, 0.9  # the car moves if the quantile QUANTILE of the ratios exceeds MOVES


def lowest_share(shares: np.ndarray, valid: np.ndarray) -> float:
    """Return the median of the lowest row's shares without street [F] of valid frames: others may
    show a standstill.
    """
    return float(np.median(shares[valid > 0])) if valid.any() else 0.0


class Still:
    """Sums of squared changes from image to image, as recorded and as expected from a STEP straight
    ahead.

    No pixel below the horizon shows anything farther than the ground. So when the car moves, it
    changes at least as much as the ground there would, unless it shows a part of the car, or text.
    """

    def __init__(self, camera: Camera) -> None:
        self._K, (height, width) = camera.K, camera.size
        self._uv = np.mgrid[:height, :width][::-1, GRID, GRID]
        self._sums = np.zeros((2, *self._uv.shape[1:]), np.float32)
        self.mask = np.zeros((height, width), bool)  # pixels in and near places where nothing moves

    def add(self, before: np.ndarray, now: np.ndarray, slope: float) -> None:
        """Compare consecutive images uint8 [H,W]; `slope`: of the road, metres down per metre
        ahead.
        """
        focal = self._K[1, 1]
        # from its focus
        from_expansion = self._uv - (self._K[:2, 2] + [0, focal * slope])[:, None, None]
        # of the ground, as a share of its distance
        nearer = STEP * np.maximum(from_expansion[1] / focal, 0)
        u, v = (self._uv - from_expansion * nearer / (1 + nearer)).astype(np.float32)
        expected = cv2.remap(before, u, v, cv2.INTER_LINEAR)
        here = now[GRID, GRID].astype(np.float32)
        changes = np.stack(
            [cv2.blur((here - there) ** 2, AROUND) for there in (before[GRID, GRID], expected)]
        )
        clear = changes[1] > LEAST
        if clear.any() and np.quantile(changes[0][clear] / changes[1][clear], QUANTILE) > MOVES:
            self._sums = KEEP * self._sums + changes
            still = (self._sums[1] > LEAST) & (self._sums[0] < STILL * self._sums[1])
            places = cv2.dilate(cv2.erode(still.astype(np.uint8), SMALL), NEAR)
            self.mask = (
                cv2.resize(places, self.mask.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
            )
