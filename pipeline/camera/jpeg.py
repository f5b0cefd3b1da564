"""JPEG files, read strictly: OpenCV fills what a cut file lacks with grey, and only prints a warning."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import DamagedFile

_START, _SCAN, _END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"  # markers: of the file, of pixels, of the end


def read_jpeg(path: Path) -> np.ndarray:
    """Return the pixels, RGB uint8 [H,W,3], turned as the file says a camera was held. Raises DamagedFile."""
    import cv2

    content = path.read_bytes()
    if not content.startswith(_START):
        raise DamagedFile(f"{path} is not a JPEG file" if content else f"{path} is empty")
    # Within the pixels no marker occurs; a preview before them is a whole JPEG of its own.
    if content.rfind(_END) < content.rfind(_SCAN):
        raise DamagedFile(f"{path} is cut short at {len(content)} bytes")
    pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    if pixels is None:
        raise DamagedFile(f"{path} cannot be decoded")
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)
