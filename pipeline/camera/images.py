"""Read, crop and resize images, depth and class maps.

OpenCV 5 refuses damaged files; earlier versions fill the missing part with grey.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from pipeline.base.errors import DamagedFile, InputError

# Oldest major version of OpenCV, as in pyproject.toml. Installing the package opencv-python
# silently replaces it with another version. After that is uninstalled, the module cv2 is empty.
OPENCV = 5
_version = getattr(cv2, "__version__", "0")
if int(_version.partition(".")[0]) < OPENCV:
    _package = f"opencv-python-headless>={OPENCV}.0"
    _fix = f'Install it again: pip install --force-reinstall --no-deps "{_package}"'
    # This ends the process, as stages import this file outside of the function that prints an
    # InputError.
    raise SystemExit(f"error: expected OpenCV {OPENCV}.0 or later, got {_version}. {_fix}")

Size = tuple[int, int]  # (H, W) in pixels

# Number of units of stored depth in a metre, as in KITTI's depth benchmark.
DEPTH_UNITS_PER_M = 256
# Largest stored depth in these units.
MAX_UNITS = np.iinfo(np.uint16).max

# The first bytes of a PNG file.
_PNG = b"\x89PNG\r\n\x1a\n"
# The first bytes of a JPEG file.
_JPEG = b"\xff\xd8"
# Pattern of EXIF's tag 0x0112, orientation, with a value from 2 to 8, in little or big endian. A
# value of 1 would be an upright image.
_ROTATED = re.compile(
    rb"\x12\x01\x03\0\x01\0\0\0[\x02-\x08]\0|\x01\x12\0\x03\0\0\0\x01\0[\x02-\x08]"
)


class Crop(NamedTuple):
    """The rows and columns of an image that are used."""

    rows: slice
    columns: slice
    image_size: Size  # (H, W) of the complete image

    @property
    def size(self) -> Size:
        """Return the size (H, W) of the crop."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    def cut_out(self, image: np.ndarray) -> np.ndarray:
        """Return the used pixels of an image [H,W,…]."""
        return np.ascontiguousarray(image[self.rows, self.columns])


def to_metres(units: np.ndarray) -> np.ndarray:
    """Convert stored depth uint16 to float64 metres; 0 stays 0 (no depth)."""
    return units / float(DEPTH_UNITS_PER_M)


def to_units(depth_m: np.ndarray) -> np.ndarray:
    """Convert depth in metres to stored depth uint16, at least 1.

    0 stays 0, which is no depth.
    """
    units = np.clip(np.rint(depth_m * DEPTH_UNITS_PER_M), 1, MAX_UNITS).astype(np.uint16)
    units[depth_m == 0] = 0
    return units


def format_size(shape: Sequence[int]) -> str:
    """Format an image shape (H, W, …) as "W x H" for messages."""
    return f"{shape[1]} x {shape[0]}"


def read_image(path: Path, size: Size | None = None) -> np.ndarray:
    """Read an image as RGB uint8 [H,W,3]. A grey value becomes three equal ones.

    Raises DamagedFile, and InputError if the pixels have another type. Raises InputError also for
    an image of another `size` (H, W), if that is given.
    """
    pixels = _read_typed_pixels(path, size, np.uint8)
    if pixels.ndim == 2:
        return np.repeat(pixels[..., None], 3, axis=-1)
    return pixels


def read_depth(path: Path, size: Size | None = None) -> np.ndarray:
    """Read dense depth, float64 [H,W] in metres; 0 is no depth.

    Raises the same exceptions as :func:`read_image`.
    """
    return to_metres(_read_typed_pixels(path, size, np.uint16, grey=True))


def read_classes(path: Path, size: Size | None = None) -> np.ndarray:
    """Read class numbers, uint8 [H,W].

    Raises the same exceptions as :func:`read_image`.
    """
    return _read_typed_pixels(path, size, np.uint8, grey=True)


def _read_typed_pixels(
    path: Path, size: Size | None, dtype: type, *, grey: bool = False
) -> np.ndarray:
    """Return the pixels of a file, [H,W] if `grey`. Raise InputError for others."""
    pixels = read_pixels(path)
    if size and pixels.shape[:2] != size:
        actual = format_size(pixels.shape)
        expected = format_size(size)
        problem = f"image has {actual} pixels (expected {expected}, as its calibration)"
        fix = "Use the synced and rectified archives, and the calibration of the same date"
        raise InputError(problem, path, fix)
    if grey and pixels.ndim == 3:
        # OpenCV decodes a palette to its colours.
        problem = "is in colour: save it as one channel, without a palette"
        raise InputError(problem, path)
    if pixels.dtype != dtype:
        problem = f"expected {np.dtype(dtype)} pixels, got {pixels.dtype} with shape {pixels.shape}"
        raise InputError(problem, path)
    return pixels


def resize_image(image: np.ndarray, size: Size) -> np.ndarray:
    """Resize an image uint8 [H,W,3] to `size` (H, W). `Camera.scaled` gives the new intrinsics."""
    height, width = image.shape[:2]
    if (height, width) == size:
        return image
    # INTER_AREA keeps thin structures, but is defined for shrinking only.
    interpolation = cv2.INTER_LINEAR
    if size[0] <= height and size[1] <= width:
        interpolation = cv2.INTER_AREA
    return cv2.resize(image, size[::-1], interpolation=interpolation)


def resize_nearest(pixels: np.ndarray, size: Size) -> np.ndarray:
    """Resize depth or classes [H,W] by picking pixels.

    Pixels are not averaged, since the mean of two depths or classes lies on neither surface.
    """
    # INTER_NEAREST_EXACT picks by pixel centres, as Camera.scaled assumes. INTER_NEAREST is off by
    # half a pixel.
    return cv2.resize(pixels, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)


def read_pixels(path: Path) -> np.ndarray:
    """Decode a PNG or JPEG file to pixels, grey [H,W] or RGB [H,W,3], of type uint8 or uint16.

    The pixels of a JPEG file are always RGB uint8. Raises DamagedFile if the file is truncated,
    altered or of another format, or if its EXIF data rotate it.
    """
    content = path.read_bytes()
    if not content.startswith((_PNG, _JPEG)):
        raise DamagedFile("is not a PNG or JPEG file", path)
    has_exif = b"eXIf" in content or b"Exif" in content
    if has_exif and _ROTATED.search(content):
        problem = "EXIF orientation rotates or mirrors the image"
        raise DamagedFile(problem, path, "Apply it: mogrify -auto-orient FILE")

    flags = cv2.IMREAD_UNCHANGED
    if content.startswith(_JPEG):
        flags = cv2.IMREAD_COLOR
    try:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error as error:
        raise DamagedFile(f"cannot be decoded ({error.err})", path) from error
    if pixels is None:
        raise DamagedFile("cannot be decoded: the file is damaged or cut short", path)
    if pixels.ndim == 2:
        return pixels
    return cv2.cvtColor(pixels[..., :3], cv2.COLOR_BGR2RGB)  # without a fourth channel, opacity


def write_png(path: Path, pixels: np.ndarray, *options: int) -> None:
    """Write grey [H,W] or RGB [H,W,3] pixels, uint8 or uint16, to a PNG file.

    `options` are OpenCV's options for PNG files: key, value, key, value, and so on.
    """
    stored = pixels
    if pixels.ndim == 3:
        stored = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    _, content = cv2.imencode(".png", stored, list(options))
    path.write_bytes(content.tobytes())
