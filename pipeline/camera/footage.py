"""Somebody's own recording, a video file or a folder of images: its images one by one, in bounded memory."""

import math
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.files import check_file
from pipeline.camera.images import Size
from pipeline.camera.jpeg import read_jpeg
from pipeline.camera.png import read_png
from pipeline.camera.video_clock import VideoClock

_MOST_BYTES = 1 << 40  # of a video
_READERS: dict[str, Callable[[Path], np.ndarray]] = {".png": read_png, ".jpg": read_jpeg, ".jpeg": read_jpeg}


class Image(NamedTuple):
    """number counts from 0; time_s is in seconds since the first image, None if unknown; image is RGB uint8 [H,W,3]."""

    number: int
    time_s: float | None
    image: np.ndarray


@dataclass
class ImageFolder:
    """The PNG and JPEG files of a folder, in the order of the numbers in their names, or of the names."""

    path: Path
    files: list[Path]
    size: Size
    fps: float | None

    @property
    def count(self) -> int:
        return len(self.files)

    def frames(self) -> Iterator[Image]:
        """Read the images one by one. Raises DamagedFile; InputError if one is of another size than the first."""
        for index, path in enumerate(self.files):
            image = _read(path)
            if image.shape[:2] != self.size:
                raise InputError(_SIZES.format(what=path, is_=_size(image.shape), first=_size(self.size)))
            yield Image(index, None if self.fps is None else index / self.fps, image)


@dataclass
class Video:
    """A video file. `count` is what it announces, which may be an estimate; None if it does not."""

    path: Path
    size: Size
    fps: float | None
    count: int | None
    fixed_fps: bool
    """Whether times come from `fps`, and not from the file's timestamps."""
    untimed_from: int | None = field(default=None, init=False)
    """The image from which on :meth:`frames` took times from `fps`, because the file's timestamps did not increase."""

    def frames(self) -> Iterator[Image]:
        """Decode the images one by one, turned as the file says the camera was held.

        Times are the file's timestamps as long as they increase, and from there on by the frame rate.

        Raises DamagedFile if it ends before what it announces, or lacks both timestamps and a frame rate; InputError if
        images have other sizes than the first.
        """
        capture = _open(self.path)
        clock = VideoClock(self.path, self.fps, start=0 if self.fixed_fps else None)
        try:
            index = -1
            while True:
                read, image = capture.read()
                if not read:
                    break
                index += 1
                if image.shape[:2] != self.size:
                    what = f"{self.path}, image {index},"
                    raise InputError(_SIZES.format(what=what, is_=_size(image.shape), first=_size(self.size)))
                time_s = clock.time_s(index, _position_s(capture))
                self.untimed_from = None if self.fixed_fps else clock.start
                yield Image(index, time_s, _rgb(image))
        finally:
            capture.release()
        self._check_end(index + 1, clock.last_s)

    def _check_end(self, images: int, last_s: float) -> None:
        """Raise DamagedFile if it has fewer images than announced, by number and by time: some containers estimate."""
        if not self.count or not self.fps:
            return
        least = self.count - max(2, self.count // 100)
        if images < least and last_s < (least - 1) / self.fps:
            raise DamagedFile(
                f"{self.path} ends after {images} of the {self.count} images that it announces: copy it again; if that "
                f"is all there is, write it anew: ffmpeg -i {self.path.name} -c copy whole{self.path.suffix}"
            )


Footage = ImageFolder | Video


def open_footage(path: Path, fps: float | None = None) -> Footage:
    """Open a video file or a folder of images.

    Args:
        path: the file or folder.
        fps: images per second, where it is known better than the file says; a folder says nothing.

    Raises InputError if there are no images, DamagedFile if the first cannot be decoded.
    """
    if not path.exists():
        raise InputError(f"{path} is missing: name a video file, or a folder of PNG or JPEG images")
    if path.is_dir():
        files = sorted((file for file in path.iterdir() if file.suffix.lower() in _READERS), key=_order)
        if not files:
            raise InputError(f"{path} holds no images: PNG and JPEG files (.png, .jpg, .jpeg) are read")
        height, width = _read(files[0]).shape[:2]
        return ImageFolder(path, files, (height, width), fps)
    return _open_video(path, fps)


def _open_video(path: Path, fps: float | None) -> Video:
    import cv2

    capture = _open(path)
    read, image = capture.read()
    own_fps, count = capture.get(cv2.CAP_PROP_FPS), capture.get(cv2.CAP_PROP_FRAME_COUNT)
    capture.release()
    if not read:
        raise DamagedFile(f"{path} is a video of which no image can be decoded: copy it again, or convert it to H.264")
    known = own_fps if math.isfinite(own_fps) and own_fps > 0 else None
    announced = int(count) if math.isfinite(count) and count > 0 else None
    return Video(path, image.shape[:2], fps or known, announced, fixed_fps=fps is not None)


def _open(path: Path) -> Any:
    """Return OpenCV's open video. Raises DamagedFile."""
    # FFmpeg and OpenCV print what they think of a file beside the one line that a user is to read.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read once, as the first video is opened
    import cv2

    check_file(path, _MOST_BYTES)
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    finally:
        cv2.utils.logging.setLogLevel(level)
    if not capture.isOpened():
        raise DamagedFile(f"{path} cannot be decoded as a video: it is cut short or of another kind; convert it to MP4")
    return capture


def _position_s(capture: Any) -> float:
    import cv2

    return float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000


def _read(path: Path) -> np.ndarray:
    """Return RGB uint8 [H,W,3], grey repeated. Raises DamagedFile."""
    pixels = _READERS[path.suffix.lower()](path)
    if pixels.dtype != np.uint8:
        raise DamagedFile(f"{path} has {pixels.dtype} pixels, 8 bits per channel are expected")
    return np.repeat(pixels[..., None], 3, axis=-1) if pixels.ndim == 2 else pixels


def _rgb(image: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _order(path: Path) -> tuple[list[int | str], str]:
    """Return a key by which img_9 comes before img_10."""
    parts = re.split(r"(\d+)", path.stem)
    return [int(part) if odd % 2 else part for odd, part in enumerate(parts)], path.name


_SIZES = "{what} is {is_} pixels, the first image is {first}: images of one recording have one size"


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"
