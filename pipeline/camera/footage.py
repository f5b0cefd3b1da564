"""Read a recording, a video file or a folder of images, one frame at a time."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.images import Size, format_size, read_pixels
from pipeline.camera.video import Image, Video, open_video

_SUFFIXES = (".png", ".jpg", ".jpeg")
_SMALLEST_PX = 16  # of a side


@dataclass
class ImageFolder:
    """The PNG and JPEG files of a folder, in the order of the numbers in their names, then of the names."""

    path: Path
    files: list[Path]
    size: Size
    fps: float | None
    times_s: list[float] | None = None
    """Seconds since the first image, if the names are timestamps and `fps` is None."""

    @property
    def count(self) -> int:
        return len(self.files)

    def frames(self) -> Iterator[Image]:
        """Read the images one by one. Raises DamagedFile; InputError if the size differs from the first image's."""
        for index, path in enumerate(self.files):
            image = _read(path)
            if image.shape[:2] != self.size:
                sizes = f"{format_size(image.shape)} pixels (expected {format_size(self.size)}, as the first image)"
                raise InputError(f"image has {sizes}", path, "Move images of other sizes to another folder")
            time_s = self.times_s[index] if self.times_s else None
            yield Image(index, time_s if self.fps is None else index / self.fps, image)


Footage = ImageFolder | Video


def open_footage(path: Path, fps: float | None = None) -> Footage:
    """Open a video file or a folder of images.

    Args:
        fps: frames per second; replaces timestamps of a video, and timestamps in ns as names of images. Times of images
            with other names are unknown without it.

    Raises InputError if there are no images or they are too small, DamagedFile if the first cannot be decoded.
    """
    if not (path.is_dir() or path.is_file()):
        raise InputError("path is missing or not a regular file", path, "Pass a video, or a folder of images")
    footage = _open_folder(path, fps) if path.is_dir() else open_video(path, fps)
    if min(footage.size) < _SMALLEST_PX:
        sizes = f"{format_size(footage.size)} pixels (expected at least {_SMALLEST_PX} x {_SMALLEST_PX})"
        raise InputError(f"images are too small: {sizes}", path)
    return footage


def _open_folder(path: Path, fps: float | None) -> ImageFolder:
    files = sorted((file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES), key=_order)
    if not files:
        raise InputError(f"folder has no images (expected {', '.join(_SUFFIXES)})", path)
    height, width = _read(files[0]).shape[:2]
    return ImageFolder(path, files, (height, width), fps, None if fps else _times(files))


def _times(files: list[Path]) -> list[float] | None:
    """Return the seconds since the first of the images if all names are timestamps in ns since 1970, as 19 digits."""
    if not all(re.fullmatch("[12][0-9]{18}", file.stem) for file in files):
        return None
    return [(int(file.stem) - int(files[0].stem)) / 1e9 for file in files]


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
