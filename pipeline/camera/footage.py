"""Open a recording, a video file or a folder of images, whose frames have times."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.files import MiB, check_increase, check_limit, read_bytes
from pipeline.camera.images import Size, format_size, read_pixels
from pipeline.camera.video import Image, Video, check_count, mean_rate

LATEST_S = 4e9  # since 1970: year 2096
LEAST_STEP_S = 1e-5  # between images, or between samples of a log
_SUFFIXES = (".png", ".jpg", ".jpeg")
_SMALLEST_PX = 16  # of a side
_MOST_BYTES = 128 * MiB  # of a file of times


@dataclass
class ImageFolder:
    """The PNG and JPEG files of a folder, in the order of the numbers in their names, then of the names."""

    path: Path
    files: list[Path]
    size: Size
    times_s: np.ndarray | None  # [F]; None if unknown
    untimed_from: int | None = None  # as of a Video

    @property
    def count(self) -> int:
        return len(self.files)

    @property
    def fps(self) -> float | None:
        return None if self.times_s is None else mean_rate(self.times_s)

    @property
    def has_times(self) -> bool:
        return self.times_s is not None

    def set_rate(self, fps: float) -> None:
        """Use `fps` images per second, for images without times."""
        self.times_s = np.arange(len(self.files)) / fps

    def frames(self) -> Iterator[Image]:
        """Read the images one by one. Raises DamagedFile; InputError if the size differs from the first image's."""
        for index, path in enumerate(self.files):
            image = _read(path)
            if image.shape[:2] != self.size:
                sizes = f"{format_size(image.shape)} pixels (expected {format_size(self.size)}, as the first image)"
                raise InputError(f"image has {sizes}", path, "Move images of other sizes to another folder")
            yield Image(index, math.nan if self.times_s is None else float(self.times_s[index]), image)


Footage = ImageFolder | Video


def open_footage(path: Path, fps: float | None = None, times: Path | None = None) -> Footage:
    """Open a video file or a folder of images.

    Args:
        fps: frames per second; replaces timestamps of a video, and timestamps in ns as names of images. Without it,
            images with other names and raw streams, such as .h264 and .mjpeg files, have no times.
        times: a file with the time of each image instead, see :func:`read_times`.

    Raises InputError if there are no images, they are too small, or `times` cannot be used; DamagedFile if the first
    cannot be decoded.
    """
    if fps and times:
        raise InputError("expected one source of the images' times, got two", fix="Pass --fps or --times")
    if not (path.is_dir() or path.is_file()):
        raise InputError("path is missing or not a regular file", path, "Pass a video, or a folder of images")
    times_s = read_times(times) if times else None
    footage = _open_folder(path, fps, times_s) if path.is_dir() else Video(path, fps, times_s)
    if min(footage.size) < _SMALLEST_PX:
        sizes = f"{format_size(footage.size)} pixels (expected at least {_SMALLEST_PX} x {_SMALLEST_PX})"
        raise InputError(f"images are too small: {sizes}", path)
    return footage


def _open_folder(path: Path, fps: float | None, times_s: np.ndarray | None) -> ImageFolder:
    files = sorted((file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES), key=_order)
    if not files:
        raise InputError(f"folder has no images (expected {', '.join(_SUFFIXES)})", path)
    height, width = _read(files[0]).shape[:2]
    folder = ImageFolder(path, files, (height, width), times_s)
    if times_s is not None:
        check_count(path, len(files), len(times_s))
    elif fps:
        folder.set_rate(fps)
    elif all(re.fullmatch("[12][0-9]{18}", file.stem) for file in files):  # ns since 1970
        folder.times_s = np.array([(int(file.stem) - int(files[0].stem)) / 1e9 for file in files])
    return folder


def _read(path: Path) -> np.ndarray:
    """Return RGB uint8 [H,W,3], grey repeated. Raises DamagedFile."""
    pixels = read_pixels(path)
    if pixels.dtype != np.uint8:
        raise DamagedFile(f"expected 8 bits per channel, got {pixels.dtype}", path)
    return np.repeat(pixels[..., None], 3, axis=-1) if pixels.ndim == 2 else pixels


def _order(path: Path) -> tuple[list[int | str], str]:
    """Return a sort key that puts img_9 before img_10."""
    parts = re.split(r"(\d+)", path.stem)
    return [int(part) if odd % 2 else part for odd, part in enumerate(parts)], path.name


def read_times(path: Path) -> np.ndarray:
    """Return the times of images, one number in seconds per line, float64 [F]. Raises InputError."""
    if not path.is_file():
        raise InputError("file is missing or not a regular file", path, "Pass --times a time in seconds per image")
    try:
        times_s = np.array(read_bytes(path, _MOST_BYTES).decode("utf-8-sig", errors="replace").split(), np.float64)
    except ValueError as error:
        raise InputError(f"expected one number per line ({error})", path) from error
    if not len(times_s):
        raise InputError("file is empty (expected one number per line)", path)
    check_times(times_s, path)
    return times_s


def check_times(times_s: np.ndarray, path: Path) -> None:
    """Raise InputError if times [N] of the file at `path` are implausible or do not increase."""
    check_limit("time_s", times_s, LATEST_S, path)
    check_increase("time_s", times_s, LEAST_STEP_S, path)
