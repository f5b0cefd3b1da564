"""Read a video file one frame at a time, with timestamps."""

import math
import weakref
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.images import Size, format_size

if TYPE_CHECKING:
    from av.container import InputContainer

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
