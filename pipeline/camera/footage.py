"""Read a recording, a video file or a folder of images, one frame at a time, with timestamps."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.images import Size, format_size, read_pixels

_SUFFIXES = (".png", ".jpg", ".jpeg")
_SMALLEST_PX = 16  # of a side
_CONVERT = "Copy the file again, or convert it: ffmpeg -i {name} -c:v libx264 converted.mp4"


class Image(NamedTuple):
    """Frame `number`, from 0; seconds since the first frame, None if unknown; RGB uint8 [H,W,3]."""

    number: int
    time_s: float | None
    image: np.ndarray


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


class Clock:
    """Times of frames since the first: the file's timestamps while they increase, then the frame rate."""

    def __init__(self, path: Path, fps: float | None, fixed_fps: bool) -> None:
        self._path, self._fps = path, fps
        self.untimed_from: int | None = 0 if fixed_fps else None
        self.last_s, self._first_s, self._untimed_s = -math.inf, 0.0, 0.0

    def time_s(self, index: int, timestamp_s: float | None) -> float:
        """Return the time of frame `index`, which the file puts at `timestamp_s`. Raises DamagedFile."""
        if index == 0:
            self._first_s = timestamp_s or 0.0
        since_s = -math.inf if timestamp_s is None else timestamp_s - self._first_s
        if self.untimed_from is None and not since_s > self.last_s:
            self.untimed_from, self._untimed_s = max(0, index - 1), max(0.0, self.last_s)
        if self.untimed_from is not None:
            if self._fps is None:
                raise DamagedFile("video has neither timestamps nor a frame rate", self._path, "Pass --fps")
            since_s = self._untimed_s + (index - self.untimed_from) / self._fps
        self.last_s = since_s
        return since_s


@dataclass
class Video:
    """A video file. `count` is the number of frames in its header, which may be an estimate; None if absent."""

    path: Path
    size: Size
    fps: float | None
    count: int | None
    fixed_fps: bool
    """Whether times follow from `fps` and not from the file's timestamps."""
    untimed_from: int | None = field(default=None, init=False)
    """The frame from which :meth:`frames` used `fps`, because the file's timestamps did not increase."""

    def frames(self) -> Iterator[Image]:
        """Yield the frames one by one, rotated as the file's display matrix demands.

        Raises DamagedFile if a frame cannot be decoded, frames are missing at the end, or times are unknown;
        InputError if the size changes.
        """
        clock, index = Clock(self.path, self.fps, self.fixed_fps), -1
        for index, (timestamp_s, image) in enumerate(_decode(self.path)):
            if image.shape[:2] != self.size:
                sizes = f"{format_size(image.shape)} pixels (expected {format_size(self.size)}, as the first frame)"
                raise InputError(f"frame {index} has {sizes}", self.path, "Cut the video where its size changes")
            time_s = clock.time_s(index, timestamp_s)
            self.untimed_from = None if self.fixed_fps else clock.untimed_from
            yield Image(index, time_s, image)
        self._check_end(index + 1, clock.last_s)

    def _check_end(self, frames: int, last_s: float) -> None:
        """Raise DamagedFile if frames are missing by number and by time; one of the two may be an estimate."""
        if not self.count or not self.fps:
            return
        least = self.count - max(2, self.count // 100)
        if frames < least and last_s < (least - 1) / self.fps:
            raise DamagedFile(
                f"ends after {frames} of {self.count} frames", self.path, _CONVERT.format(name=self.path.name)
            )


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
    footage = _open_folder(path, fps) if path.is_dir() else _open_video(path, fps)
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


def _open_video(path: Path, fps: float | None = None) -> Video:
    """Read a video's header and first frame; `fps` replaces its timestamps. Raises DamagedFile."""
    import av

    first = next(_decode(path), None)
    if first is None:
        raise DamagedFile("video has no frames", path, _CONVERT.format(name=path.name))
    with path.open("rb") as file, av.open(file, "r") as container:
        stream = container.streams.video[0]
        rate = stream.average_rate or stream.guessed_rate
        own_fps = float(rate) if rate else None
        count = stream.frames
        if not count and container.duration and own_fps:
            count = round(container.duration / av.time_base * own_fps)
    return Video(path, first[1].shape[:2], fps or own_fps, count or None, fixed_fps=fps is not None)


def _decode(path: Path) -> Iterator[tuple[float | None, np.ndarray]]:
    """Yield timestamp in seconds and RGB uint8 [H,W,3] of each frame. Raises DamagedFile."""
    import av

    decoded = 0
    with path.open("rb") as file:  # FFmpeg would take some names for addresses or patterns
        try:
            with av.open(file, "r") as container:
                if not container.streams.video:
                    raise DamagedFile("file has no video stream", path)
                stream = container.streams.video[0]
                stream.thread_type = "AUTO"
                for frame in container.decode(stream):
                    image = frame.to_ndarray(format="rgb24")
                    yield frame.time, np.ascontiguousarray(np.rot90(image, frame.rotation // 90))
                    decoded += 1
        except (av.FFmpegError, OSError) as error:
            where = f"after {decoded} frames" if decoded else "as a video"
            raise DamagedFile(f"cannot be decoded {where}", path, _CONVERT.format(name=path.name)) from error
