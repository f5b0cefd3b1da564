"""JPEG files, read strictly: OpenCV fills what a cut file lacks with grey, and only prints a warning."""

import re
from pathlib import Path

import numpy as np

from pipeline.base.errors import DamagedFile
from pipeline.base.files import read_bytes
from pipeline.camera.png import MOST_BYTES, check_size

# A frame's header: marker, length, bits, height, width. Within the pixels no marker occurs.
_SIZES = re.compile(rb"\xff[\xc0-\xc3\xc5-\xc7\xc9-\xcb\xcd-\xcf]\x00[\x0b\x11]\x08(..)(..)", re.DOTALL)
_START, _SCAN, _END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"  # markers: of the file, of pixels, of the end


def read_jpeg(path: Path) -> np.ndarray:
    """Return the pixels, RGB uint8 [H,W,3], turned as the file says a camera was held. Raises DamagedFile."""
    import cv2

    content = read_bytes(path, MOST_BYTES)
    if not content.startswith(_START):
        raise DamagedFile(f"{path} is not a JPEG file" if content else f"{path} is empty")
    for height, width in _SIZES.findall(content):
        check_size(path, int.from_bytes(width, "big"), int.from_bytes(height, "big"))
    # Within the pixels no marker occurs; a preview before them is a whole JPEG of its own.
    if content.rfind(_END) < content.rfind(_SCAN):
        raise DamagedFile(f"{path} is cut short at {len(content)} bytes")
    try:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise DamagedFile(f"{path} cannot be decoded: {error.err}") from error
    if pixels is None:
        raise DamagedFile(f"{path} cannot be decoded")
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)
