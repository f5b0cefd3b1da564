"""Recognise videos that hold both images of a stereo camera, beside or above each other."""

from pathlib import Path

import cv2
import numpy as np

from pipeline.base.errors import InputError

# Width in pixels of a half when the halves are compared.
WIDTH = 240
# Largest shift in pixels between the two images: 12 % of their width. In the images of KITTI's
# stereo camera, objects at a distance of 3 m are shifted by so much.
REACH = 28
# Blocks of a half in each direction; each has its own shift.
BLOCKS = 6
# Least height in pixels of a block.
LEAST_HEIGHT = 4
# Least standard deviation of a block's derivative, in grey levels, for a block with structure.
STRUCTURE = 0.5
# Least share of blocks that must have structure for a comparison of the halves.
STRUCTURED = 1 / 3
# Least median correlation of the halves at which they are images of a stereo camera. Those of
# stereo cameras have 0.66 at a baseline of 54 cm, and 0.9 at 12 cm. Halves of other images of
# streets have at most 0.25, also at night, in fog or with black bars, and 0.44 if out of focus.
ALIKE = 0.55


def likeness(grey: np.ndarray) -> tuple[float, float]:
    """Return how alike the halves of an image uint8 [H,W] are, as two correlations.

    The first is that of the left and the right half, the second that of the upper and the lower
    half. A correlation is NaN if a half has not enough structure.
    """
    wide = _structure(grey, 2 * WIDTH)
    side_by_side = _correlation(wide[:, :WIDTH], wide[:, WIDTH:])
    narrow = _structure(grey, WIDTH)
    middle = len(narrow) // 2
    above = _correlation(narrow[:middle], narrow[middle : 2 * middle])
    return side_by_side, above


def _structure(grey: np.ndarray, width: int) -> np.ndarray:
    """Return the mixed derivative, along x and y, of an image that is resized to this width.

    Edges of black bars, which would make the halves of any image alike, have a derivative of 0:
    they are straight along one of the axes.
    """
    height = max(1, round(grey.shape[0] * width / grey.shape[1]))
    small = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    return np.asarray(cv2.Sobel(small, cv2.CV_32F, 1, 1, ksize=5, scale=1 / 32))


def _correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Return the median correlation of the blocks of one half with the other.

    Each block is shifted along its rows to where it fits best.
    """
    height, width = first.shape
    if height < LEAST_HEIGHT * BLOCKS:
        return np.nan
    correlations = list[float]()
    for rows in np.array_split(np.arange(height), BLOCKS):
        for columns in np.array_split(np.arange(width), BLOCKS):
            block = first[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            if block.std() > STRUCTURE:
                reach = slice(max(0, columns[0] - REACH), columns[-1] + 1 + REACH)
                around = second[rows[0] : rows[-1] + 1, reach]
                match = cv2.matchTemplate(around, block, cv2.TM_CCOEFF_NORMED)
                correlations.append(float(match.max()))
    if len(correlations) < STRUCTURED * BLOCKS**2:
        return np.nan
    return float(np.median(correlations))


def refuse_stereo(likenesses: np.ndarray, path: Path) -> None:
    """Raise InputError if images are those of a stereo camera, by their :func:`likeness` [N,2]."""
    side_by_side, above = likenesses.T
    if _median(side_by_side) > ALIKE:
        _refuse("side by side", "left", "iw/2:ih", path)
    if _median(above) > ALIKE:
        _refuse("one above the other", "upper", "iw:ih/2", path)


def _median(values: np.ndarray) -> float:
    """Return the median of the finite values; 0 if there are none."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0
    return float(np.median(finite))


def _refuse(where: str, half: str, size: str, path: Path) -> None:
    crop = f"ffmpeg -i {path.name} -vf crop={size}:0:0 {half}.mp4"
    raise InputError(
        f"has both images of a stereo camera, {where}", path, f"Crop the {half} one: {crop}"
    )
