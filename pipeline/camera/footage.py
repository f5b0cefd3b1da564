"""Open a recording, a video file or a folder of images, one frame at a time, with times."""

import math
import re
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.files import MiB, check_increase, check_limit, read_bytes
from pipeline.camera.images import Size, format_size, read_pixels

if TYPE_CHECKING:
    from av.container import InputContainer

LATEST_S = 4e9  # since 1970: year 2096
LEAST_STEP_S = 1e-5  # between images, or between samples of a log
_SUFFIXES = (".png", ".jpg", ".jpeg")
_SMALLEST_PX = 16  # of a side
_MOST_BYTES = 128 * MiB  # of a file of times
_CONVERT = "Copy the file again, or convert it: ffmpeg -i {name} -c:v libx264 converted.mp4"
# Playlists, scripts and session descriptions can open other files and sockets. So only containers and streams of frames
# are accepted, and no protocol: FFmpeg reads the file that is already open.
_WITHOUT_TIMES = ("h264", "hevc", "m4v", "mpegvideo", "mjpeg", "obu")
_CONTAINERS = ("mov", "mp4", "matroska", "webm", "avi", "mpegts", "mpeg", "ivf", "ogg", "flv", "asf", "yuv4mpegpipe")
_OPTIONS = {
    "format_whitelist": ",".join((*_CONTAINERS, *_WITHOUT_TIMES)),
    "protocol_whitelist": "none",
    "enable_drefs": "0",  # references of MOV files to other files
    "use_absolute_path": "0",
}
_Timed = tuple[float | None, np.ndarray]


class Image(NamedTuple):
    """Frame `number`, from 0; seconds since the first frame or by the file of times, NaN if unknown; RGB [H,W,3]."""

    number: int
    time_s: float
    image: np.ndarray


def mean_rate(times_s: np.ndarray) -> float | None:
    """Return the frames per second of images at `times_s` [F]; None for a single one."""
    return float((len(times_s) - 1) / (times_s[-1] - times_s[0])) if len(times_s) > 1 else None


def check_count(path: Path, images: int, times: int) -> None:
    """Raise InputError if images and times differ in number."""
    if images != times:
        raise InputError(f"has {images} images, but --times has {times} lines (expected one each)", path)


class _Times:
    """Times of frames since the first: the file's timestamps while they increase, then the frame rate."""

    def __init__(self, path: Path, fps: float | None, fixed_fps: bool) -> None:
        self._path, self._fps = path, fps
        self.untimed_from: int | None = 0 if fixed_fps else None
        self.last_s, self._first_s, self._untimed_s = -math.inf, 0.0, 0.0

    def time_s(self, index: int, timestamp_s: float | None) -> float:
        """Return the time of frame `index`, whose timestamp in the file is `timestamp_s`. Raises DamagedFile."""
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


class Video:
    """A video file, opened once: a second pass over the frames rewinds the open file.

    ``size`` is (H, W). ``fps`` is None if unknown. ``count`` is the number of frames in the header, which may be an
    estimate, or None. ``untimed_from`` is the frame from which :meth:`frames` used ``fps``, because the file's
    timestamps did not increase, or None. ``has_times``: whether frames have times. ``times_s`` [F]: of all frames, if
    they are from a file of times.
    """

    def __init__(self, path: Path, fps: float | None, times_s: np.ndarray | None) -> None:
        """Read the header and the first frame; `fps` or `times_s` replaces timestamps. Raises DamagedFile."""
        self.path, self.times_s, self._fixed_fps = path, times_s, fps is not None
        self.untimed_from: int | None = None
        self._file = path.open("rb")  # FFmpeg interprets some names as addresses or patterns
        weakref.finalize(self, self._file.close)
        container = self._open()
        # FFmpeg assumes 25 frames per second for a stream without a container.
        without_times = container.format.name in _WITHOUT_TIMES
        self.has_times = self._fixed_fps or times_s is not None or not without_times
        self.fps = fps or (None if without_times else _frame_rate(container))
        if times_s is not None:
            self.fps = mean_rate(times_s)
        self.count = None if without_times else _frame_count(container)
        frames = self._decode(container)
        first = next(frames, None)
        if first is None:
            raise DamagedFile("video has no frames", path, _CONVERT.format(name=path.name))
        self.size: Size = (first[1].shape[0], first[1].shape[1])
        self._unread: Iterator[_Timed] | None = chain([first], frames)

    def frames(self) -> Iterator[Image]:
        """Yield the frames one by one, rotated as the file's display matrix demands. One pass at a time.

        Raises DamagedFile if a frame cannot be decoded, frames are missing at the end, or timestamps and frame rate
        are missing; InputError if the size changes, or ``times_s`` has another length.
        """
        decoded, self._unread = self._unread or self._decode(self._open()), None
        times, index = _Times(self.path, self.fps, self._fixed_fps), -1
        for index, (timestamp_s, image) in enumerate(decoded):
            if image.shape[:2] != self.size:
                sizes = f"{format_size(image.shape)} pixels (expected {format_size(self.size)}, as the first frame)"
                raise InputError(f"frame {index} has {sizes}", self.path, "Cut the video where its size changes")
            if self.times_s is not None:
                if index < len(self.times_s):
                    yield Image(index, float(self.times_s[index]), image)
                continue
            time_s = times.time_s(index, timestamp_s) if self.has_times else math.nan
            self.untimed_from = None if self._fixed_fps else times.untimed_from
            yield Image(index, time_s, image)
        if self.times_s is not None:
            check_count(self.path, index + 1, len(self.times_s))
        else:
            self._check_end(index + 1, times.last_s)

    def set_rate(self, fps: float) -> None:
        """Use `fps` frames per second, for a stream without times."""
        self.fps, self._fixed_fps, self.has_times = fps, True, True

    def _check_end(self, frames: int, last_s: float) -> None:
        """Raise DamagedFile if frames are missing by number and by time; one of the two may be an estimate."""
        if not self.count or not self.fps:
            return
        least = self.count - max(2, self.count // 100)
        if frames < least and last_s < (least - 1) / self.fps:
            raise DamagedFile(
                f"ends after {frames} of {self.count} frames", self.path, _CONVERT.format(name=self.path.name)
            )

    def _open(self) -> "InputContainer":
        """Read the header, from the start of the file. Raises DamagedFile without a video stream."""
        import av

        self._file.seek(0)
        try:
            container = av.open(self._file, "r", options=_OPTIONS, metadata_errors="replace")
        except (av.FFmpegError, OSError) as error:
            problem = "cannot be opened as a video (expected a container like MP4, MOV, Matroska, AVI or MPEG)"
            raise DamagedFile(problem, self.path, _CONVERT.format(name=self.path.name)) from error
        if not container.streams.video:
            raise DamagedFile("file has no video stream", self.path)
        return container

    def _decode(self, container: "InputContainer") -> Iterator[_Timed]:
        """Yield timestamp in seconds and RGB uint8 [H,W,3] of each frame. Raises DamagedFile."""
        import av

        decoded = 0
        try:
            with container:
                stream = container.streams.video[0]
                stream.thread_type = "AUTO"
                for frame in container.decode(stream):
                    image = frame.to_ndarray(format="rgb24")
                    yield frame.time, np.ascontiguousarray(np.rot90(image, frame.rotation // 90))
                    decoded += 1
        except (av.FFmpegError, OSError) as error:
            where = f"after {decoded} frames" if decoded else "as a video"
            raise DamagedFile(f"cannot be decoded {where}", self.path, _CONVERT.format(name=self.path.name)) from error


def _frame_rate(container: "InputContainer") -> float | None:
    stream = container.streams.video[0]
    rate = stream.average_rate or stream.guessed_rate
    return float(rate) if rate else None


def _frame_count(container: "InputContainer") -> int | None:
    """Return the number of frames by the header, or by duration and frame rate; None if unknown."""
    import av

    count, duration, fps = container.streams.video[0].frames, container.duration or 0, _frame_rate(container)
    if "matroska" in container.format.name:  # its duration is the time of the end
        duration -= container.start_time or 0
    if not count and duration > 0 and fps:
        count = round(duration / av.time_base * fps)
    return count or None


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
