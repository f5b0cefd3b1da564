"""Decode and encode image files. OpenCV 5 refuses damaged files; earlier versions fill the missing part with grey."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import DamagedFile
from pipeline.base.files import MiB, read_bytes

_PNG, _PNG_END, _JPEG = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82", b"\xff\xd8"
_MOST_BYTES = 256 * MiB


def read_pixels(path: Path) -> np.ndarray:
    """Decode a PNG or JPEG file.

    Returns: [H,W] or RGB [H,W,3], uint8 or uint16. JPEG is always RGB uint8, rotated as its EXIF orientation demands.

    Raises DamagedFile if the file is truncated, altered or of another kind.
    """
    import cv2

    content = read_bytes(path, _MOST_BYTES)
    if not content:
        raise DamagedFile("file is empty", path)
    if not content.startswith((_PNG, _JPEG)):
        raise DamagedFile("is not a PNG or JPEG file", path)
    if content.startswith(_PNG) and _PNG_END not in content:  # libpng would print a line of its own
        raise DamagedFile(f"PNG is cut short at {len(content)} bytes", path)
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
    if pixels.ndim == 3 and pixels.shape[2] != 3:
        raise DamagedFile(f"expected grey or RGB pixels, got {pixels.shape[2]} channels", path)
    return pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)


def write_png(path: Path, pixels: np.ndarray, *options: int) -> None:
    """Encode grey [H,W] or RGB [H,W,3] pixels, uint8 or uint16, with OpenCV's PNG `options` (pairs of key and value).

    Raises OSError.
    """
    import cv2

    stored = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    encoded, content = cv2.imencode(".png", stored, list(options))
    if not encoded:
        raise OSError(f"cannot encode an image of shape {pixels.shape}, {pixels.dtype}, as PNG: {path}")
    path.write_bytes(content.tobytes())
