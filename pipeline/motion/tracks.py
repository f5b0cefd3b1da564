"""Corners of an image, spread over it, and where the next image shows them."""

import numpy as np

PER_CELL = 2  # corners
WINDOW, LEVELS = (11, 11), 2  # px, halvings; a larger window is slower, and sees more of what lies at another depth
UNTIL = (3, 8, 0.03)  # 8 iterations, or one that moves it by less than 0.03 px
BACK_PX = 0.5  # tracked to the next image and back, a corner ends at most so far from where it began


class Corners:
    """The corners of an image uint8 [H,W]."""

    def __init__(self, grey: np.ndarray) -> None:
        import cv2

        # The least eigenvalue of the gradients' products over 3 x 3 px, of intensities 0 to 1.
        quality = cv2.cornerMinEigenVal(grey, blockSize=3)
        self._quality = np.where(quality == cv2.dilate(quality, np.ones((5, 5), np.uint8)), quality, 0)

    def best(self, wanted: np.ndarray, cell: int, quality: float) -> np.ndarray:
        """Return the PER_CELL best of each square of `cell` px, float32 [N,2] as (u, v), where `wanted` [H,W] is true.

        `quality` is the least that one may have.
        """
        v, u = np.nonzero(wanted & (self._quality > quality))
        best_first = np.argsort(-self._quality[v, u], kind="stable")
        v, u = v[best_first], u[best_first]
        of_cell = v // cell * (wanted.shape[1] // cell + 1) + u // cell
        by_cell = np.argsort(of_cell, kind="stable")  # within a cell, still the best first
        _, first, counts = np.unique(of_cell[by_cell], return_index=True, return_counts=True)
        rank = np.arange(len(v)) - np.repeat(first, counts)
        chosen = by_cell[rank < PER_CELL]
        return np.stack([u[chosen], v[chosen]], axis=-1).astype(np.float32)


def follow(before: np.ndarray, now: np.ndarray, uv: np.ndarray, uv_guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Track corners of image `before` to image `now`, both uint8 [H,W], by pyramidal Lucas-Kanade, there and back.

    Args:
        uv: corners, float32 [N,2].
        uv_guess: where they may be in `now`, float32 [N,2].

    Returns: where they are in `now`, float32 [N,2], and whether to believe it, bool [N].
    """
    import cv2

    if not len(uv):
        return uv, np.zeros(0, bool)
    how = WINDOW, LEVELS, UNTIL, cv2.OPTFLOW_USE_INITIAL_FLOW
    there, there_ok, _ = cv2.calcOpticalFlowPyrLK(before, now, uv, uv_guess.copy(), None, None, *how)
    back_guess = there - (uv_guess - uv)
    back, back_ok, _ = cv2.calcOpticalFlowPyrLK(now, before, there, back_guess, None, None, *how)
    height, width = now.shape
    inside = (there >= 0).all(axis=1) & (there[:, 0] < width) & (there[:, 1] < height)
    returned = np.linalg.norm(back - uv, axis=1) < BACK_PX
    return there, (there_ok[:, 0] > 0) & (back_ok[:, 0] > 0) & returned & inside
