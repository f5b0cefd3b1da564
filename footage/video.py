"""Read the images of a recording and their times, from a video file or a folder of images."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import av
import numpy as np
from av.container import InputContainer
from av.stream import Disposition
from av.video.stream import VideoStream

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.images import read_image

# Suffixes of images.
PICTURES = (".png", ".jpg", ".jpeg")
# Formats of streams without a container, whose images have no times.
_WITHOUT_TIMES = ("h264", "hevc", "m4v", "mpegvideo", "mjpeg", "obu")
# Formats of containers.
_CONTAINERS = (
    "mov",
    "mp4",
    "matroska",
    "webm",
    "avi",
    "mpegts",
    "mpeg",
    "ivf",
    "ogg",
    "flv",
    "asf",
    "yuv4mpegpipe",
)
# Options of FFmpeg. Playlists, scripts and session descriptions can open other files and sockets,
# so only the formats above are accepted. No protocol is accepted, as FFmpeg reads a file that is
# already open.
_OPTIONS = {
    "format_whitelist": ",".join((*_CONTAINERS, *_WITHOUT_TIMES)),
    "protocol_whitelist": "none",
    "enable_drefs": "0",  # references of MOV files to other files
    "use_absolute_path": "0",
}
# Advice for a file that cannot be decoded.
CONVERT = "Copy the file again, or convert it: ffmpeg -i {name} -c:v libx264 converted.mp4"
# Largest deviation from 1 of a pixel's width over its height at which the pixel counts as square.
SQUARE = 0.01
# Least share that a complete file has of the frames, or of the duration, that its header gives. It
# may also lack one frame.
INEXACT = 0.99
# Longest duration in seconds of a last image whose duration the file does not store.
LAST_S = 0.2


@dataclass(frozen=True)
class Images:
    """The images of a video file, or of a folder, in order."""

    path: Path
    # Images of a folder; empty for a video.
    files: list[Path]
    # Number of images. In a video, it is that of packets that are shown.
    count: int
    # Whether the times are even, by a rate, instead of those in the file.
    is_even: bool
    # Median time in seconds between two images; NaN if the file has no times.
    step_s: float
    # Seconds between the first and the last image; NaN if the file has no times.
    length_s: float

    def read(self, every: int, count: int) -> Iterator[tuple[float, np.ndarray | None]]:
        """Yield the seconds since the first image, and the pixels, RGB [H,W,3], of each image.

        Of images whose place, counted from `count`, is no multiple of `every`, the pixels are None.
        Raises DamagedFile if an image cannot be decoded, or a video ends before its header says so.
        """
        for place, file in enumerate(self.files):
            wanted = (count + place) % every == 0
            yield place * self.step_s, read_image(file) if wanted else None
        if self.files:
            return

        first_s = None
        for place, frame in enumerate(_decode(self.path)):
            wanted = (count + place) % every == 0
            stamp_s = np.nan if frame.time is None else frame.time
            if first_s is None:
                first_s = stamp_s
            seconds = place * self.step_s if self.is_even else stamp_s - first_s
            yield seconds, _upright(frame, self.path) if wanted else None

    def at_rate(self, fps: float | None) -> "Images":
        """Return the images with their own times, or for `fps` with even times.

        Raises InputError if their times are unusable, or images of a folder seem to be missing.
        """
        if fps:
            _check_numbers(self.files)
            length_s = (self.count - 1) / fps
            return replace(self, is_even=True, step_s=1 / fps, length_s=length_s)
        if np.isnan(self.step_s):
            raise InputError("images have no times", self.path, "Pass --fps N, or --times FILE")
        if not self.step_s > 0:
            raise DamagedFile("times do not increase", self.path, "Pass --fps N")
        return self


def open_images(path: Path) -> Images:
    """Return the images of a video, or of a folder, without decoding them. Raises InputError."""
    if not path.exists():
        raise InputError("path is missing", path, "Pass a video, or a folder of images")
    if path.is_dir():
        files = _image_files(path)
        return Images(path, files, len(files), False, np.nan, np.nan)

    with _container(path) as (container, stream):
        shape = float(stream.sample_aspect_ratio or 1)
        unit_s = float(stream.time_base or 1)
        # For streams without a container, FFmpeg assumes 25 frames per second.
        has_times = container.format.name not in _WITHOUT_TIMES
        stamps = []
        for packet in container.demux(stream):
            # An edit list may hide packets.
            if packet.size and not packet.is_discard:
                stamps.append(packet.pts)
    if abs(shape - 1) > SQUARE:
        fix = f"Scale it: ffmpeg -i {path.name} -vf scale=iw*sar:ih,setsar=1 square.mp4"
        raise InputError(f"pixels are not square ({shape:.3f} times as wide as high)", path, fix)

    known = np.sort([stamp for stamp in stamps if stamp is not None])
    if not has_times or len(known) < 2:
        return Images(path, [], len(stamps), False, np.nan, np.nan)
    step_s = float(np.median(np.diff(known))) * unit_s
    length_s = float(known[-1] - known[0]) * unit_s
    return Images(path, [], len(stamps), False, step_s, length_s)


def _image_files(folder: Path) -> list[Path]:
    """Return the PNG and JPEG files of a folder in natural order: img_9 before img_10.

    Raises InputError if there are none.
    """
    files = [
        path for path in folder.iterdir() if path.suffix.lower() in PICTURES and path.name[0] != "."
    ]
    if not files:
        raise InputError(f"folder has no images (expected {', '.join(PICTURES)})", folder)
    parts = {path: re.split(r"(\d+)", path.stem) for path in files}

    def order(path: Path) -> list[str | int]:
        return [int(part) if part.isdecimal() else part for part in parts[path]]

    files.sort(key=order)
    return files


def _check_numbers(files: list[Path]) -> None:
    """Raise InputError if the last numbers in the names do not rise evenly.

    An image may be missing, or the images be those of two cameras.
    """
    numbers = [re.findall(r"\d+", path.stem)[-1:] for path in files]
    steps = np.diff([int(*number) for number in numbers if number])
    for step, before, after in zip(steps, files[:-1], files[1:], strict=False):
        if step != steps[0] or step <= 0:
            raise InputError(
                f"numbers in the names do not rise evenly: {after.name} follows {before.name}",
                before.parent,
                "Pass --times FILE, or a folder with the images of one camera",
            )


def _decode(path: Path) -> Iterator[av.VideoFrame]:
    """Yield the images of a video from the first key frame on.

    Raises DamagedFile if it is cut short or has bad bytes.
    """
    with _container(path) as (container, stream):
        stream.thread_type = "AUTO"
        packets = 0
        started = False
        end_s = 0.0
        for packet in container.demux():
            unit_s = packet.time_base or 0
            # A packet that is cut short, as the last one may be, does not count.
            if not packet.is_corrupt:
                packet_end = (packet.pts or 0) + (packet.duration or 0)
                end_s = max(end_s, float(packet_end * unit_s))
            if packet.stream is not stream:
                continue
            packets += packet.size > 0
            started = started or packet.is_keyframe
            if not started:
                continue
            try:
                yield from stream.decode(packet)
            except av.FFmpegError as error:
                seconds = float((packet.pts or 0) * unit_s)
                problem = f"is damaged at about image {packets}, {seconds:.1f} s"
                part = f"ffmpeg -i {path.name} -t {max(seconds - 2, 0):.0f} -c copy start.mp4"
                fix = f"Copy the file again, or use the part before: {part}"
                raise DamagedFile(problem, path, fix) from error
        _check_complete(container, stream, path, packets, end_s)


def _check_complete(
    container: InputContainer, stream: VideoStream, path: Path, packets: int, end_s: float
) -> None:
    """Raise DamagedFile if a file ends before its header says so.

    `packets` images were read, and the last packet of all streams ends at `end_s`.

    The edit list of an MP4 or MOV file may leave out stored frames. Such a file is complete if its
    duration is that of the header. The header of a Matroska file does not have the number of
    frames, but the duration of the longest stream.
    """
    stored = stream.frames
    is_cut = packets < INEXACT * stored - 1
    total_s = (container.duration or 0) / av.time_base
    kind = container.format.name
    if "matroska" in kind or (is_cut and "mov" in kind):
        is_cut = end_s < INEXACT * total_s - LAST_S
    if is_cut:
        end = f"{packets} of {stored} frames" if stored else f"{end_s:.1f} of {total_s:.1f} s"
        raise DamagedFile(f"ends after {end}", path, CONVERT.format(name=path.name))


@contextmanager
def _container(path: Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    """Yield an open file and its video stream, the default one if there are several.

    Raises DamagedFile, also if FFmpeg fails in the block.
    """
    # FFmpeg gets an open file, as it would interpret some names as addresses or patterns.
    with path.open("rb") as file:
        try:
            with av.open(file, "r", options=_OPTIONS, metadata_errors="replace") as container:
                # A picture that is attached, such as a cover, is a stream, too.
                streams = [
                    stream
                    for stream in container.streams.video
                    if not stream.disposition & Disposition.attached_pic
                ]
                if not streams:
                    raise DamagedFile("file has no video stream", path)
                streams.sort(key=lambda stream: not stream.disposition & Disposition.default)
                yield container, streams[0]
        except (av.FFmpegError, OSError) as error:
            raise DamagedFile(
                "cannot be decoded as a video (expected a container like MP4, MOV, Matroska, AVI "
                "or MPEG)",
                path,
                CONVERT.format(name=path.name),
            ) from error


def _upright(frame: av.VideoFrame, path: Path) -> np.ndarray:
    """Return the image RGB uint8 [H,W,3], rotated by its display matrix.

    Raises InputError for a matrix that does not turn by multiples of 90 degrees.
    """
    image = frame.to_ndarray(format="rgb24")
    display = cast(Any, frame.side_data.get("DISPLAYMATRIX"))
    if display is not None:
        # Rotations have a = d and b = -c. By multiples of 90 degrees, a or b is 0.
        a, b, _, c, d, *_ = np.frombuffer(display, np.int32).tolist()
        if (a, b) != (d, -c) or (a and b):
            raise InputError(
                "display matrix mirrors the images or turns them by no multiple of 90 degrees",
                path,
                f"Apply it to the pixels: ffmpeg -i {path.name} -c:v libx264 upright.mp4",
            )
        image = np.rot90(image, frame.rotation // 90)
    return np.ascontiguousarray(image)
