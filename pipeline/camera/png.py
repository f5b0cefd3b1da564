"""PNG files, read strictly.

OpenCV decodes what it can of a cut or altered file and only prints a warning, so the file's own checksums are
verified first (1 ms per KITTI image).
"""

import zlib
from pathlib import Path

import numpy as np

from pipeline.base.errors import DamagedFile
from pipeline.base.files import MiB, read_bytes

MOST_BYTES = 256 * MiB  # of an image's file
_MOST_PIXELS = 1 << 26  # 8192 x 8192, as KITTI has 1242 x 375
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def read_png(path: Path) -> np.ndarray:
    """Return the pixels as stored: [H,W] or RGB [H,W,3], uint8 or uint16. Raises DamagedFile."""
    import cv2

    content = read_bytes(path, MOST_BYTES)
    _check(content, path)
    try:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise DamagedFile(f"{path} cannot be decoded: {error.err}") from error
    if pixels is None or (pixels.ndim == 3 and pixels.shape[2] != 3):
        raise DamagedFile(f"{path} is not a grey or RGB image")
    return pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)


def check_size(path: Path, width: int, height: int) -> None:
    """Raise DamagedFile if an image's header announces none, or more pixels than there is any sense in decoding."""
    if not 0 < width * height <= _MOST_PIXELS:
        raise DamagedFile(f"{path} announces {width} x {height} pixels: an image has at most {_MOST_PIXELS}")


def _check(content: bytes, path: Path) -> None:
    if not content.startswith(_SIGNATURE):
        raise DamagedFile(f"{path} is not a PNG file" if content else f"{path} is empty")
    if len(content) >= 24:
        if content[12:16] != b"IHDR":
            raise DamagedFile(f"{path} is damaged: it does not begin with its header")
        check_size(path, *(int.from_bytes(content[start : start + 4], "big") for start in (16, 20)))
    at = len(_SIGNATURE)
    # A chunk: length, kind, data, CRC-32 of kind and data; the last one is IEND.
    while at + 12 <= len(content):
        end = at + 12 + int.from_bytes(content[at : at + 4], "big")
        if end > len(content):
            break
        if zlib.crc32(content[at + 4 : end - 4]) != int.from_bytes(content[end - 4 : end], "big"):
            raise DamagedFile(f"{path} is damaged: the checksum at byte {at} is wrong")
        if content[at + 4 : at + 8] == b"IEND":
            return
        at = end
    raise DamagedFile(f"{path} is cut short at {len(content)} bytes")
