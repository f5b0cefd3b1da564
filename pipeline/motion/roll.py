"""Measure the camera's roll about its axis by edges that are upright: walls, poles, trees."""

import cv2
import numpy as np

from pipeline.camera.camera import Camera

# Number of frames of which one is examined: the roll is constant.
EVERY = 5
# Largest angle in degrees between an edge that counts and the image's columns.
MAX_DEG = 20.0
# Width in degrees of a bin of the histogram of angles.
BIN_DEG = 0.1
# Standard deviation in degrees of the Gaussian that smooths the histogram.
SMOOTH_DEG = 2.0
# Standard deviation in pixels of the Gaussian that smooths the image.
IMAGE_PX = 1.0
# Standard deviation in pixels of the Gaussian that smooths products of gradients.
PRODUCTS_PX = 2.5
# Least coherence of the gradients around a pixel of an edge: 1 is a straight edge, 0 has no
# direction.
COHERENT = 0.9
# Least magnitude of the gradient by Sobel at an edge, in grey levels.
STRONG = 30.0
# Share of the width left out on either side: a video that was rotated by software has oblique black
# corners there.
MARGIN = 0.1
# Least share of the pixels above the horizon on such edges. Recordings with buildings or trees have
# 0.01 and more, the motorway of 2011_10_03_drive_0042 0.0009.
MIN_SHARE = 0.006
# Least ratio of the peak of the histogram to its median. Streets have 3.3 to 12, bare hills, whose
# angles mislead, 1.5.
MIN_PEAK = 3.0


class Roll:
    """Sums the histogram of the angles of nearly upright edges above the horizon."""

    def __init__(self, camera: Camera) -> None:
        height, width = camera.size
        left = round(MARGIN * width)
        horizon = int(np.clip(camera.K[1, 2], 0, height))
        self._used = (slice(0, horizon), slice(left, width - left))
        self._pixels = horizon * (width - 2 * left)
        self._edges_deg = np.arange(-MAX_DEG, MAX_DEG + BIN_DEG / 2, BIN_DEG)
        self._counts = np.zeros(len(self._edges_deg) - 1)
        self._images = 0

    def add(self, image: np.ndarray) -> None:
        """Add the edges of an image RGB uint8 [H,W,3]."""
        sharp = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
        grey = cv2.GaussianBlur(sharp, (0, 0), IMAGE_PX)
        across = cv2.Sobel(grey, cv2.CV_32F, 1, 0)
        down = cv2.Sobel(grey, cv2.CV_32F, 0, 1)

        # The direction of the gradient is that of the larger eigenvector of the structure tensor
        # around a pixel.
        xx = cv2.GaussianBlur(across * across, (0, 0), PRODUCTS_PX)
        yy = cv2.GaussianBlur(down * down, (0, 0), PRODUCTS_PX)
        xy = cv2.GaussianBlur(across * down, (0, 0), PRODUCTS_PX)
        angle_deg = np.degrees(np.arctan2(2 * xy, xx - yy) / 2)
        straight = np.hypot(xx - yy, 2 * xy) > COHERENT * (xx + yy)
        strong = xx + yy > STRONG**2

        used = (straight & strong)[self._used]
        self._counts += np.histogram(angle_deg[self._used][used], self._edges_deg)[0]
        self._images += 1

    def degrees(self) -> float:
        """Return the images' roll, clockwise positive; 0 if too few edges are upright."""
        if self._counts.sum() <= MIN_SHARE * self._pixels * max(self._images, 1):
            return 0.0

        # Smooth the histogram by a Gaussian, as far as it has values on both sides.
        reach = round(3 * SMOOTH_DEG / BIN_DEG)
        sigmas = np.arange(-reach, reach + 1) * BIN_DEG / SMOOTH_DEG
        kernel = np.exp(-(sigmas**2) / 2)
        smooth = np.convolve(self._counts, kernel, mode="valid")

        peak = int(np.argmax(smooth))
        if smooth[peak] < MIN_PEAK * np.median(smooth):
            return 0.0
        centres_deg = self._edges_deg[:-1] + BIN_DEG / 2
        return float(centres_deg[reach + peak])
