"""Detect corners, spread over the image, and track them to the next image."""

import numpy as np

PER_CELL = 2  # corners
WINDOW, LEVELS = (11, 11), 2  # px, pyramid levels; a larger window is slower and covers several depths
CRITERIA = (3, 8, 0.03)  # 8 iterations, or a change below 0.03 px
ROUND_TRIP_PX = 0.5  # largest distance between a corner and its track to the next image and back


class Corners:
    """The corners of an image uint8 [H,W]."""

    def __init__(self, grey: np.ndarray) -> None:
        import cv2

        # The least eigenvalue of the structure tensor over 3 x 3 px, intensities from 0 to 1.
        quality = cv2.cornerMinEigenVal(grey, blockSize=3)
        self._quality = np.where(quality == cv2.dilate(quality, np.ones((5, 5), np.uint8)), quality, 0)

    def best(self, mask: np.ndarray, cell: int, min_quality: float) -> np.ndarray:
        """Return the PER_CELL best corners of each square of `cell` px, float32 [N,2] as (u, v).

        Only corners in `mask` bool [H,W] with a quality above `min_quality` count.
        """
        v, u = np.nonzero(mask & (self._quality > min_quality))
        best_first = np.argsort(-self._quality[v, u], kind="stable")
        v, u = v[best_first], u[best_first]
        cell_index = v // cell * (mask.shape[1] // cell + 1) + u // cell
        by_cell = np.argsort(cell_index, kind="stable")  # within a cell, the best is still first
        _, first, counts = np.unique(cell_index[by_cell], return_index=True, return_counts=True)
        rank = np.arange(len(v)) - np.repeat(first, counts)
        chosen = by_cell[rank < PER_CELL]
        return np.stack([u[chosen], v[chosen]], axis=-1).astype(np.float32)


def track(before: np.ndarray, now: np.ndarray, uv: np.ndarray, uv_guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Track corners of image `before` to image `now`, both uint8 [H,W], by pyramidal Lucas-Kanade, forth and back.

    Args:
        uv: corners, float32 [N,2].
        uv_guess: initial positions in `now`, float32 [N,2].

    Returns: positions in `now`, float32 [N,2], and whether they passed the round-trip check, bool [N].
    """
    import cv2

    if not len(uv):
        return uv, np.zeros(0, bool)
    options = WINDOW, LEVELS, CRITERIA, cv2.OPTFLOW_USE_INITIAL_FLOW
    forth, forth_ok, _ = cv2.calcOpticalFlowPyrLK(before, now, uv, uv_guess.copy(), None, None, *options)
    back_guess = forth - (uv_guess - uv)
    back, back_ok, _ = cv2.calcOpticalFlowPyrLK(now, before, forth, back_guess, None, None, *options)
    height, width = now.shape
    inside = (forth >= 0).all(axis=1) & (forth[:, 0] < width) & (forth[:, 1] < height)
    returned = np.linalg.norm(back - uv, axis=1) < ROUND_TRIP_PX
    return forth, (forth_ok[:, 0] > 0) & (back_ok[:, 0] > 0) & returned & inside
