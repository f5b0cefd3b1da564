"""Find what stays in place in the image while the street moves: a bonnet, text."""

import cv2
import numpy as np

from pipeline.camera.camera import Camera

# Rows and columns of the pixels that are compared, the points of a grid.
GRID = slice(2, None, 4)
# Size of the area around a point, in points of the grid, over which changes are averaged.
MEAN_OVER = (5, 5)
# Size of the specks, in points of the grid, that are too small to be part of a car, or text.
SPECK = np.ones((3, 3), np.uint8)
# Size of the area around a still point, in points of the grid, that is left out with it.
AROUND_STILL = np.ones((7, 7), np.uint8)
# Length in camera heights of the step ahead for which changes are predicted. A car that moves goes
# farther from image to image.
STEP = 0.1
# Factor on the sums at each image.
DECAY = 0.9
# Least predicted change in squared grey levels, 20². Smaller ones are noise.
LEAST_CHANGE = 400.0
# Largest ratio of recorded to predicted changes where nothing moves.
STILL = 0.2
# Quantile of the ratios of an image's recorded changes to the predicted ones that tells whether the
# car moves.
RATIO_QUANTILE = 0.75
# Least value of this quantile if the car moves. The ratio is 1 on flat ground after a step of STEP,
# and larger for what is nearer than the ground.
LEAST_RATIO = 0.9


class Still:
    """Sums squared changes from image to image, as recorded and as predicted for a STEP ahead.

    No pixel below the horizon shows anything farther than the ground. So when the car moves, a
    pixel changes at least as much as if it showed ground, unless it shows a part of the car, or
    text.
    """

    def __init__(self, camera: Camera) -> None:
        height, width = camera.size
        self._K = camera.K
        self._uv = np.mgrid[:height, :width][::-1, GRID, GRID]
        self._recorded = np.zeros(self._uv.shape[1:], np.float32)
        self._predicted = np.zeros_like(self._recorded)
        # Pixels in and near places where nothing moves.
        self.mask = np.zeros((height, width), bool)

    def add_images(self, before: np.ndarray, now: np.ndarray, slope: float) -> None:
        """Compare consecutive images uint8 [H,W]; `slope`: the road's metres down per metre."""
        grey = now[GRID, GRID].astype(np.float32)
        recorded = cv2.blur((grey - before[GRID, GRID]) ** 2, MEAN_OVER)
        predicted = cv2.blur((grey - self._predict_step(before, slope)) ** 2, MEAN_OVER)

        is_clear = predicted > LEAST_CHANGE
        if not is_clear.any():
            return
        ratios = recorded[is_clear] / predicted[is_clear]
        # While the car stands, nothing tells a bonnet from the street.
        if np.quantile(ratios, RATIO_QUANTILE) <= LEAST_RATIO:
            return

        self._recorded = DECAY * self._recorded + recorded
        self._predicted = DECAY * self._predicted + predicted
        still = (self._predicted > LEAST_CHANGE) & (self._recorded < STILL * self._predicted)

        # An erosion removes single points, which are chance. The dilation is larger, since means at
        # the edge of a bonnet include what moves beside it.
        places = cv2.erode(still.astype(np.uint8), SPECK)
        places = cv2.dilate(places, AROUND_STILL)
        size = self.mask.shape[::-1]
        self.mask = cv2.resize(places, size, interpolation=cv2.INTER_NEAREST) > 0

    def _predict_step(self, before: np.ndarray, slope: float) -> np.ndarray:
        """Return the grid's grey levels after a STEP ahead if the image shows flat ground only."""
        focal = self._K[1, 1]
        focus_of_expansion = self._K[:2, 2] + [0, focal * slope]
        from_focus = self._uv - focus_of_expansion[:, None, None]

        # Share of its distance by which the ground at a pixel comes nearer: ground in direction v
        # is focal / v camera heights away. What is now at a distance from the focus of expansion
        # was at that distance / (1 + nearer) before.
        nearer = STEP * np.maximum(from_focus[1] / focal, 0)
        u, v = (self._uv - from_focus * nearer / (1 + nearer)).astype(np.float32)
        return cv2.remap(before, u, v, cv2.INTER_LINEAR)
