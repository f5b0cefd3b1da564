"""Image files, and images, depth and class maps of a drive, cropped and resized to the working
size.

OpenCV 5 refuses damaged files; earlier versions fill the missing part with grey.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from pipeline.base.errors import DamagedFile, InputError

# Oldest main version of OpenCV, as in pyproject.toml. Installing opencv-python replaces it without
# a word from pip.
OPENCV = 5
# after pip uninstall opencv-python, the module is empty
_version = getattr(cv2, "__version__", "0")
if int(_version.partition(".")[0]) < OPENCV:
    _fix = "Install it again: pip install --force-reinstall --no-deps "
    _fix += f'"opencv-python-headless>={OPENCV}.0"'
    # Ends the process, as stages import this file outside of the function that prints an
    # InputError.
    raise SystemExit(f"error: expected OpenCV {OPENCV}.0 or later, got {_version}. {_fix}")
Size = tuple[int, int]  # (H, W) pixels
DEPTH_UNITS_PER_M = 256  # of stored depth, as in KITTI's depth benchmark; 0: no depth
MAX_UNITS = np.iinfo(np.uint16).max
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
# EXIF's tag 0x0112, orientation, one short number, little or big endian; 1 is upright.
_ROTATED = re.compile(
    rb"\x12\x01\x03\0\x01\0\0\0[\x02-\x08]\0|\x01\x12\0\x03\0\0\0\x01\0[\x02-\x08]"
)


class Crop(NamedTuple):
    """The rows and columns of an image that are used."""

    rows: slice
    columns: slice

    @property
    def size(self) -> Size:
        """(H, W) of the part."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    def pixels(self, image: np.ndarray) -> np.ndarray:
        """Return the part of an image [H,W,…]."""
        return np.ascontiguousarray(image[self.rows, self.columns])


def to_metres(units: np.ndarray) -> np.ndarray:
    """Convert stored depth uint16 to float64 metres; 0 stays 0 (no depth)."""
    return units / float(DEPTH_UNITS_PER_M)


def to_units(depth_m: np.ndarray) -> np.ndarray:
    """Convert depth in metres to stored depth uint16 (1/256 m), at least 1; 0 stays 0 (no
    depth).
    """
    units = np.clip(np.rint(depth_m * DEPTH_UNITS_PER_M), 1, MAX_UNITS).astype(np.uint16)
    units[depth_m == 0] = 0
    return units


def format_size(shape: Sequence[int]) -> str:
    """Format an image shape (H, W, …) as "W x H" for messages."""
    return f"{shape[1]} x {shape[0]}"


def read_image(path: Path, size: Size | None = None) -> np.ndarray:
    """Read RGB uint8 [H,W,3], grey repeated. Raises DamagedFile; InputError for another `size` (H,
    W) or pixel type.
    """
    pixels = _read(path, size, np.uint8)
    return np.repeat(pixels[..., None], 3, axis=-1) if pixels.ndim == 2 else pixels


def read_depth(path: Path, size: Size | None = None) -> np.ndarray:
    """Read dense depth, float64 [H,W] in metres, 0: none. `size` None accepts any; errors as
    :func:`read_image`.
    """
    return to_metres(_read(path, size, np.uint16, axes=2))


def read_classes(path: Path, size: Size | None = None) -> np.ndarray:
    """Read class numbers, uint8 [H,W]. `size` None accepts any; errors as :func:`read_image`."""
    return _read(path, size, np.uint8, axes=2)


def _read(path: Path, size: Size | None, dtype: type, axes: int | None = None) -> np.ndarray:
    pixels = read_pixels(path)
    if size and pixels.shape[:2] != size:
        sizes = (
            f"{format_size(pixels.shape)} pixels (expected {format_size(size)}, as its calibration)"
        )
        fix = "Use the synced and rectified archives, and the calibration of the same date"
        raise InputError(f"image has {sizes}", path, fix)
    if pixels.dtype != dtype or (axes and pixels.ndim != axes):
        problem = f"expected {np.dtype(dtype)} pixels, got {pixels.dtype} with shape {pixels.shape}"
        raise InputError(problem, path)
    return pixels


def resized(image: np.ndarray, size: Size) -> np.ndarray:
    """Resize an image uint8 [H,W,3]. `Camera.scaled` gives the new intrinsics."""
    height, width = image.shape[:2]
    if (height, width) == size:
        return image
    # INTER_AREA keeps thin structures, but is defined for shrinking only.
    smaller = size[0] <= height and size[1] <= width
    return cv2.resize(
        image, size[::-1], interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    )


def nearest(pixels: np.ndarray, size: Size) -> np.ndarray:
    """Resize depth or classes [H,W] by picking pixels: the mean of two depths or classes lies on
    neither surface.
    """
    # EXACT picks by pixel centres, as Camera.scaled assumes; plain INTER_NEAREST is off by half a
    # pixel.
    return cv2.resize(pixels, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)


def read_pixels(path: Path) -> np.ndarray:
    """Decode a PNG or JPEG file.

    Returns: [H,W] or RGB [H,W,3], uint8 or uint16. JPEG is always RGB uint8.

    Raises DamagedFile if the file is truncated, altered or of another kind, transparent, or to be
    shown rotated.
    """
    content = path.read_bytes()
    if not content.startswith((_PNG, _JPEG)):
        raise DamagedFile("is not a PNG or JPEG file", path)
    if (b"eXIf" in content or b"Exif" in content) and _ROTATED.search(content):
        raise DamagedFile(
            "EXIF orientation rotates or mirrors the image",
            path,
            "Apply it: mogrify -auto-orient FILE",
        )
    flags = cv2.IMREAD_COLOR if content.startswith(_JPEG) else cv2.IMREAD_UNCHANGED
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error as error:
        raise DamagedFile(f"cannot be decoded ({error.err})", path) from error
    finally:
        cv2.utils.logging.setLogLevel(level)
    if pixels is None:
        raise DamagedFile("cannot be decoded: the file is damaged or cut short", path)
    if pixels.ndim == 3 and np.invert(pixels[..., 3:], dtype=pixels.dtype).any():
        raise DamagedFile(
            "has transparent pixels", path, "Remove the transparency: mogrify -alpha off FILE"
        )
    return pixels if pixels.ndim == 2 else cv2.cvtColor(pixels[..., :3], cv2.COLOR_BGR2RGB)


def write_png(path: Path, pixels: np.ndarray, *options: int) -> None:
    """Encode grey [H,W] or RGB [H,W,3] pixels, uint8 or uint16, with OpenCV's PNG `options` (key,
    value, …).
    """
    stored = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    path.write_bytes(cv2.imencode(".png", stored, list(options))[1].tobytes())
