"""A raw drive's images and truth images, at the size that the pipeline works with."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.camera.png import read_png

Size = tuple[int, int]
"""(H, W) pixels."""
DEPTH_UNITS_PER_M = 256  # of stored depth, as in KITTI's depth benchmark; 0 is none
MAX_UNITS = np.iinfo(np.uint16).max


def to_metres(units: np.ndarray) -> np.ndarray:
    """Return depth float64 in metres of stored depth uint16; 0 stays 0, none."""
    return units / float(DEPTH_UNITS_PER_M)


def to_units(depth_m: np.ndarray) -> np.ndarray:
    """Return depth in metres as it is stored, uint16 in 1/256 m, at least 1; where it is 0 (none) it stays 0."""
    units = np.clip(np.rint(depth_m * DEPTH_UNITS_PER_M), 1, MAX_UNITS).astype(np.uint16)
    units[depth_m == 0] = 0
    return units


def read_image(path: Path, size: Size, new_size: Size) -> np.ndarray:
    """Return an image as RGB uint8 [H,W,3], grey repeated. Raises DamagedFile; InputError if it is not of `size`."""
    pixels = _read(path, size, np.uint8)
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[..., None], 3, axis=-1)
    return resized(pixels, new_size)


def resized(image: np.ndarray, size: Size) -> np.ndarray:
    """Return an image uint8 [H,W,3] at another size; :func:`pipeline.camera.geometry.scale_K` tells its intrinsics."""
    import cv2

    height, width = image.shape[:2]
    if (height, width) == size:
        return image
    # Averaging over areas keeps what is thin; it is made for shrinking only.
    smaller = size[0] <= height and size[1] <= width
    return cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)


def read_depth(path: Path, size: Size | None, new_size: Size) -> np.ndarray:
    """Return dense depth, uint16 [H,W], 1/256 m, 0 where there is none. `size` None is any; errors as `read_image`."""
    return _nearest(_read(path, size, np.uint16, axes=2), new_size)


def read_classes(path: Path, size: Size | None, new_size: Size) -> np.ndarray:
    """Return class numbers, uint8 [H,W]. `size` None is any; errors as :func:`read_image`."""
    return _nearest(_read(path, size, np.uint8, axes=2), new_size)


def _nearest(pixels: np.ndarray, new_size: Size) -> np.ndarray:
    """Resize by picking pixels: a mean of two depths or two class numbers lies on neither surface."""
    import cv2

    # EXACT picks by pixel centres, as geometry.scale_K assumes; plain INTER_NEAREST is off by half a pixel.
    return cv2.resize(pixels, new_size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)


def _read(path: Path, size: Size | None, dtype: type, axes: int | None = None) -> np.ndarray:
    pixels = read_png(path)
    if size and pixels.shape[:2] != size:
        raise InputError(
            f"{path} is {pixels.shape[1]} x {pixels.shape[0]} pixels, the calibration says {size[1]} x {size[0]}: "
            "use the synced and rectified archives, and the calibration of the same date"
        )
    if pixels.dtype != dtype or (axes and pixels.ndim != axes):
        raise InputError(
            f"{path} has {pixels.dtype} pixels of shape {pixels.shape[2:]}, {np.dtype(dtype)} are expected"
        )
    return pixels
