"""Corners of an image, spread over it, and where the next image shows them."""

import numpy as np

CELL = 24  # side of the squares, px, that give …
PER_CELL = 2  # … so many corners each, the best
QUALITY = 1e-4  # least eigenvalue of the gradients' products over a corner's 3 x 3 px, of intensities 0 to 1
WINDOW, LEVELS = (15, 15), 3  # px, halvings
UNTIL = (3, 15, 0.02)  # 15 iterations, or one that moves it by less than 0.02 px
BACK_PX = 0.5  # tracked to the next image and back, a corner ends at most so far from where it began


def corners(grey: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the corners, float32 [N,2] as (u, v), of an image uint8 [H,W] where `wanted` bool [H,W] is true."""
    import cv2

    strength = cv2.cornerMinEigenVal(grey, blockSize=3)
    peak = (strength == cv2.dilate(strength, np.ones((5, 5), np.uint8))) & wanted & (strength > QUALITY)
    v, u = np.nonzero(peak)
    order = np.argsort(-strength[v, u], kind="stable")
    u, v = u[order], v[order]
    cell = v // CELL * (grey.shape[1] // CELL + 1) + u // CELL
    by_cell = np.argsort(cell, kind="stable")  # within a cell, still the strongest first
    _, first, counts = np.unique(cell[by_cell], return_index=True, return_counts=True)
    rank = np.arange(len(cell)) - np.repeat(first, counts)
    best = by_cell[rank < PER_CELL]
    return np.stack([u[best], v[best]], axis=-1).astype(np.float32)


def follow(before: np.ndarray, now: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Track corners [N,2] of image `before` to image `now`, both uint8 [H,W].

    Pyramidal Lucas-Kanade, there and back. Returns where they are in `now`, float32 [N,2], and whether to believe it.
    """
    import cv2

    if not len(uv):
        return uv, np.zeros(0, bool)
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, now, uv[:, None], uv[:, None], None, None, WINDOW, LEVELS, UNTIL)
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(now, before, there, there, None, None, WINDOW, LEVELS, UNTIL)
    error = np.linalg.norm(back[:, 0] - uv, axis=-1)
    return there[:, 0], (found[:, 0] > 0) & (found_back[:, 0] > 0) & (error < BACK_PX)
