"""Read a recording, a video file or a folder of images, one frame at a time, with times."""

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

import av
import numpy as np
from av.container import InputContainer

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.camera import Frame
from pipeline.camera.images import Size, format_size, read_image
from pipeline.kitti.columns import check_increase

_SUFFIXES = (".png", ".jpg", ".jpeg")
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
Images = Iterator[tuple[float | None, np.ndarray]]


@dataclass
class Recording:
    """Images in order, with times: of the file of times, by a fixed rate, or the video's own timestamps."""

    path: Path
    images: Callable[[], Images]  # timestamp in seconds, if there is one, and RGB uint8 [H,W,3] of each image
    size: Size
    count: int | None  # of the images, by the header of a video; None: unknown
    start_s: float  # the first timestamp
    times_s: np.ndarray | None  # [F] of all images, if they are known in advance
    fps: float | None = None  # replaces timestamps
    straighten: Callable[[np.ndarray], np.ndarray] = lambda image: image  # without the lens' distortion

    def frames(self) -> Iterator[Frame]:
        """Yield number, time and straightened image RGB uint8 [H,W,3] of the frames; a second call starts again.

        Times count from the first frame, or are those of the file of times.

        Raises DamagedFile if an image cannot be decoded, or images are missing at the end; InputError if the size
        changes, there are more or fewer images than times, or a video's timestamps do not increase.
        """
        last_s, number = -math.inf, -1
        for number, (stamp_s, image) in enumerate(self.images()):
            if image.shape[:2] != self.size:
                sizes = f"{format_size(image.shape)} pixels (expected {format_size(self.size)}, as the first one)"
                raise InputError(f"image {number} has {sizes}", self.path, "Images of one recording have one size")
            if self.times_s is not None:
                time_s = float(self.times_s[number]) if number < len(self.times_s) else math.nan
            elif self.fps:
                time_s = number / self.fps
            else:
                time_s = math.nan if stamp_s is None else stamp_s - self.start_s
                if not time_s > last_s:
                    raise DamagedFile(f"timestamps do not increase at image {number}", self.path, "Pass --fps")
            last_s = time_s
            yield Frame(number, time_s, self.straighten(image))
        if self.times_s is not None and number + 1 != len(self.times_s):
            raise InputError(f"has {number + 1} images, but {len(self.times_s)} times", self.path)
        if self.count and number + 1 < self.count - max(2, self.count // 100):  # a header's count may be inexact
            problem = f"ends after {number + 1} of {self.count} frames"
            raise DamagedFile(problem, self.path, _CONVERT.format(name=self.path.name))

    def span_s(self) -> tuple[float, float]:
        """Return the times of the first and of the last image, without decoding any."""
        if self.times_s is not None:
            return float(self.times_s[0]), float(self.times_s[-1])
        if self.path.is_dir():
            return 0.0, ((self.count or 1) - 1) / (self.fps or 1.0)
        with _container(self.path) as container:
            stream = container.streams.video[0]
            stamps = [packet.pts for packet in container.demux(stream) if packet.size]
            last_s = float(max((stamp for stamp in stamps if stamp is not None), default=0) * (stream.time_base or 1))
        return 0.0, (len(stamps) - 1) / self.fps if self.fps else last_s - self.start_s


def open_recording(path: Path, fps: float | None = None, times: Path | None = None) -> Recording:
    """Open a video file or a folder of images.

    `fps`, or a file of `times` for :func:`read_times`, replaces timestamps of a video and those in names of images.

    Raises InputError if there are no images, they have no times, are mirrored or have pixels that are not square, or
    `times` cannot be used; DamagedFile if the first image cannot be decoded.
    """
    if fps and times:
        raise InputError("expected one source of the images' times, got two", fix="Pass --fps or --times")
    if not path.exists():
        raise InputError("path is missing", path, "Pass a video, or a folder of images")
    times_s, stamped = read_times(times) if times else None, False
    images: Callable[[], Images]
    count: int | None
    if path.is_dir():
        files = _image_files(path)
        images, count = lambda: ((None, read_image(file)) for file in files), len(files)
        if not fps and not times and all(re.fullmatch("[12][0-9]{18}", file.stem) for file in files):
            times_s = np.array([(int(file.stem) - int(files[0].stem)) / 1e9 for file in files])  # ns since 1970
    else:
        images = partial(_decode, path)
        with _container(path) as container:
            stream = container.streams.video[0]
            shape, count = float(stream.sample_aspect_ratio or 1), stream.frames or None
            stamped = container.format.name not in _WITHOUT_TIMES  # elsewhere FFmpeg assumes 25 frames per second
        if abs(shape - 1) > 0.01:
            fix = f"Scale it: ffmpeg -i {path.name} -vf scale=iw*sar:ih,setsar=1 square.mp4"
            raise InputError(f"pixels are not square ({shape:.3f} times as wide as high)", path, fix)
    if not (fps or stamped or times_s is not None):
        raise InputError("images have no times", path, "Pass --fps N, or --times FILE")
    if (first := next(images(), None)) is None:
        raise DamagedFile("video has no frames", path, _CONVERT.format(name=path.name))
    return Recording(path, images, first[1].shape[:2], count, first[0] or 0.0, times_s, fps)


def _decode(path: Path) -> Images:
    """Yield timestamps and images of a video."""
    with _container(path) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        for frame in container.decode(stream):
            yield frame.time, _upright(frame, path)


@contextmanager
def _container(path: Path) -> Iterator[InputContainer]:
    """Open a file with a video stream. Raises DamagedFile, also for errors inside of the block."""
    with path.open("rb") as file:  # FFmpeg interprets some names as addresses or patterns
        try:
            with av.open(file, "r", options=_OPTIONS, metadata_errors="replace") as container:
                if not container.streams.video:
                    raise DamagedFile("file has no video stream", path)
                yield container
        except (av.FFmpegError, OSError) as error:
            problem = "cannot be decoded as a video (expected a container like MP4, MOV, Matroska, AVI or MPEG)"
            raise DamagedFile(problem, path, _CONVERT.format(name=path.name)) from error


def _upright(frame: av.VideoFrame, path: Path) -> np.ndarray:
    """Return the image RGB uint8 [H,W,3], rotated by its display matrix. Raises InputError for other matrices."""
    image, display = frame.to_ndarray(format="rgb24"), cast(Any, frame.side_data.get("DISPLAYMATRIX"))
    if display is not None:
        a, b, _, c, d, *_ = np.frombuffer(display, np.int32).tolist()
        if (a, b) != (d, -c) or (a and b):
            fix = f"Apply it to the pixels: ffmpeg -i {path.name} -c:v libx264 upright.mp4"
            raise InputError("display matrix mirrors the images or turns them by no multiple of 90 degrees", path, fix)
        image = np.rot90(image, frame.rotation // 90)
    return np.ascontiguousarray(image)


def _image_files(folder: Path) -> list[Path]:
    """Return the PNG and JPEG files of a folder, in the order of the numbers in their names, then of the names."""
    files = [path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES and path.name[:2] != "._"]  # macOS
    if not files:
        raise InputError(f"folder has no images (expected {', '.join(_SUFFIXES)})", folder)
    parts = {path: re.split(r"(\d+)", path.stem) for path in files}
    words = {path: [int(part) if part.isdecimal() else part for part in parts[path]] for path in files}
    return sorted(files, key=lambda path: (words[path], path.name))  # img_9 before img_10


def read_times(path: Path) -> np.ndarray:
    """Return the times of images, one number in seconds per line, float64 [F]. Raises InputError."""
    try:
        times_s = np.array(path.read_text("utf-8-sig").split(), np.float64)
    except (OSError, ValueError) as error:
        raise InputError(f"expected a file with one number per line ({error})", path) from error
    check_times(times_s, path, 2.0)  # milliseconds, taken as seconds, have steps of 10 and more
    return times_s


def check_times(times_s: np.ndarray, path: Path | str, longest_s: float) -> None:
    """Raise InputError if times [N] do not increase, or by less than 1 ms or more than `longest_s` in the median."""
    check_increase("time_s", times_s, 1e-5, path)
    if len(times_s) < 2:
        raise InputError(f"expected at least 2 times, got {len(times_s)}", path)
    step_s = float(np.median(np.diff(times_s)))
    if not 0.999e-3 <= step_s <= longest_s:
        fix = "Times are in seconds: divide milliseconds by 1000. Slower samples are not interpolated"
        raise InputError(f"median time step is {step_s:g} (expected 0.001 to {longest_s:.1g} s)", path, fix)
