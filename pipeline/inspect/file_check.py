"""Whether the files of one modality of a raw drive are sound: by size, header and trailer, or decoded."""

import struct
from collections.abc import Callable, Mapping
from pathlib import Path

from pipeline.base.errors import DamagedFile
from pipeline.inspect.raw_listing import Files
from pipeline.kitti import oxts

Size = tuple[int, int]
_PNG_HEAD = b"\x89PNG\r\n\x1a\n\x00\x00\x00\x0dIHDR"
_PNG_TAIL = b"\x00\x00\x00\x00IEND\xaeB`\x82"
_LEAST_PNG = len(_PNG_HEAD) + 8 + len(_PNG_TAIL)
_POINT_BYTES = 16
# What is larger is none of KITTI's: packets have some 500 B, images 1 MB, scans 2 MB.
_MOST_BYTES = {".txt": 1 << 16, ".png": 1 << 28, ".bin": 1 << 28}
_MOST_PIXELS = 1 << 26
_THIN = 0.5  # share of the drive's median scan below which one is worth a look


def damaged(listed: Files, size: Size | None, deep: bool) -> dict[int, str]:
    """Return frame → what is wrong with its file.

    Args:
        listed: the files of one modality.
        size: (H, W) that the calibration says, of images; None: any.
        deep: decode each file as stage ingest would, instead of looking at its ends.
    """
    check = _checker(listed, size, deep)
    return {
        frame: fault
        for frame, count in listed.sizes.items()
        if (fault := _by_size(count, _MOST_BYTES[listed.suffix]) or check(frame))
    }


def _by_size(count: int, most: int) -> str:
    if count < 0:
        return "is no plain file"  # a pipe would be waited for, a device read without end
    return "is empty" if not count else f"has {count} bytes, far too many" if count > most else ""


def thin(listed: Files) -> list[int]:
    """Return the frames whose scan has less than half the points of the drive's median scan."""
    sizes = sorted(listed.sizes.values())
    least = sizes[len(sizes) // 2] * _THIN if sizes else 0
    return [frame for frame, size in listed.sizes.items() if 0 < size < least]


def _checker(listed: Files, size: Size | None, deep: bool) -> Callable[[int], str]:
    def of_image(frame: int) -> str:
        return _image(listed.path(frame), listed.sizes[frame], size)

    def of_scan(frame: int) -> str:
        count = listed.sizes[frame]
        return f"has {count} bytes, no whole number of points" if count % _POINT_BYTES else ""

    if listed.suffix == ".txt":
        return lambda frame: _fault(oxts.read_row, listed.path(frame))
    if listed.suffix == ".bin":
        return (lambda frame: of_scan(frame) or _fault(_scan_reader(), listed.path(frame))) if deep else of_scan
    return (lambda frame: of_image(frame) or _fault(_png_reader(), listed.path(frame))) if deep else of_image


def _png_reader() -> Callable[[Path], object]:
    from pipeline.camera.pixels import read_pixels

    return read_pixels


def _scan_reader() -> Callable[[Path], object]:
    from pipeline.kitti.raw import read_scan

    return read_scan


def _fault(read: Callable[[Path], object], path: Path) -> str:
    """Return what a reader of the project says of a file; nothing if it reads it."""
    try:
        read(path)
    except DamagedFile as error:
        return str(error).removeprefix(str(path)).lstrip(": ")
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    return ""


def _image(path: Path, count: int, size: Size | None) -> str:
    if count < _LEAST_PNG:
        return f"is cut short at {count} bytes"
    try:
        with path.open("rb", buffering=0) as file:
            head = file.read(len(_PNG_HEAD) + 8)
            file.seek(-len(_PNG_TAIL), 2)
            tail = file.read()
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if not head.startswith(_PNG_HEAD):
        return "is not a PNG file"
    if tail != _PNG_TAIL:
        return f"is cut short at {count} bytes, or has something behind its end"
    width, height = struct.unpack(">II", head[len(_PNG_HEAD) :])
    if width * height > _MOST_PIXELS:
        return f"says that it has {width} x {height} pixels"
    if size and (height, width) != size:
        return f"is {width} x {height} pixels, the calibration says {size[1]} x {size[0]}"
    return ""


def by_fault(faults: Mapping[int, str]) -> dict[str, list[int]]:
    """Return fault → frames: one line for all files that are cut short, whatever their sizes."""
    groups: dict[str, list[int]] = {}
    for frame, fault in faults.items():
        groups.setdefault("".join("#" if one.isdigit() else one for one in fault), []).append(frame)
    return {faults[frames[0]]: frames for frames in groups.values()}
