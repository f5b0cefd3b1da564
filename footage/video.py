"""Read the images of a recording and their times, from a video file or a folder of images."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, cast

import av
import numpy as np
from av.container import InputContainer
from av.stream import Disposition
from av.video.stream import VideoStream

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.images import Size, read_image

# Suffixes of images.
PICTURES = (".png", ".jpg", ".jpeg")
# Formats of streams without a container, whose images have no times. For them, FFmpeg assumes 25
# frames per second.
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
# Containers whose header has the duration of the complete file.
_WITH_DURATION = ("mov", "matroska", "avi")
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
SQUARE_TOLERANCE = 0.01
# Least share of a video's images with a time of their own, at which its times are used.
LEAST_TIMED = 0.5
# Least share of the duration in its header that a complete file has. The last image does not count.
LEAST_SHARE = 0.99
# Longest duration in seconds of a last image. Files need not store it.
LAST_IMAGE_S = 0.2


@dataclass(frozen=True)
class Images:
    """The images of a video file, or of a folder, in order."""

    path: Path
    # Number of images. In a video, it is that of packets that are shown.
    count: int
    # Images of a folder; empty for a video.
    files: Sequence[Path] = ()
    # Time stamp of an image in a video → its place; empty if the file has no times.
    places: Mapping[int, int] = field(default_factory=dict)
    # Seconds since the first image [count], or None if too few of them have a time.
    times_s: np.ndarray | None = None
    # Number of different times in the file.
    time_count: int = 0
    # The tag creation_time of a video.
    created: datetime | None = None

    def read_images(self, wanted: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """Yield the place and the pixels, RGB [H,W,3], of the images that are `wanted`, bool [N].

        Raises DamagedFile if an image cannot be decoded, times of a video do not increase, or a
        video ends before its header says so.
        """
        for place, file in enumerate(self.files):
            if wanted[place]:
                yield place, read_image(file)
        if self.files:
            return

        before = -1
        for number, frame in enumerate(_decode_frames(self.path)):
            place = number
            if self.places:
                stamp = cast(int, frame.pts)
                if stamp not in self.places:  # FFmpeg may decode images that an edit list hides
                    continue
                place = self.places[stamp]
            if place <= before:
                fix = CONVERT.format(name=self.path.name)
                raise DamagedFile(f"times do not increase at image {number}", self.path, fix)
            before = place
            # A file without times may have more images than packets.
            if place < self.count and wanted[place]:
                yield place, _rotate_upright(frame, self.path)

    def read_size(self) -> Size:
        """Return the size of the first image. Raises DamagedFile if there is none."""
        for _, image in self.read_images(np.ones(self.count, bool)):
            height, width = image.shape[:2]
            return height, width
        raise DamagedFile("has no images", self.path, CONVERT.format(name=self.path.name))


def open_images(path: Path) -> Images:
    """Return the images of a video, or of a folder, without decoding them. Raises InputError."""
    if not path.exists():
        raise InputError("path is missing", path, "Pass a video, or a folder of images")
    if path.is_dir():
        files = _image_files(path)
        return Images(path, files=files, count=len(files))

    with _open_container(path) as (container, stream):
        pixel_aspect = float(stream.sample_aspect_ratio or 1)
        unit_s = float(stream.time_base or 1)
        has_times = container.format.name not in _WITHOUT_TIMES
        # An edit list may hide packets.
        shown = [
            packet for packet in container.demux(stream) if packet.size and not packet.is_discard
        ]
        stamps = [packet.pts for packet in shown if packet.pts is not None]
        created = _read_date({**stream.metadata, **container.metadata})
    if abs(pixel_aspect - 1) > SQUARE_TOLERANCE:
        fix = f"Scale it: ffmpeg -i {path.name} -vf scale=iw*sar:ih,setsar=1 square.mp4"
        problem = f"pixels are not square ({pixel_aspect:.3f} times as wide as high)"
        raise InputError(problem, path, fix)

    # Times are used if all images have one, and most of them their own.
    if not has_times or len(stamps) < len(shown):
        return Images(path, count=len(shown), created=created)
    in_order = sorted(set(stamps))
    if len(in_order) < max(2, LEAST_TIMED * len(shown)):
        return Images(path, count=len(shown), time_count=len(in_order), created=created)
    times_s = (np.array(in_order) - in_order[0]) * unit_s
    places = {stamp: place for place, stamp in enumerate(in_order)}
    return Images(
        path,
        count=len(places),
        places=places,
        times_s=times_s,
        time_count=len(places),
        created=created,
    )


def _read_date(tags: Mapping[str, str]) -> datetime | None:
    """Return the date and time of a video's tag creation_time without its time zone, if known."""
    try:
        return datetime.fromisoformat(tags.get("creation_time", "")).replace(tzinfo=None)
    except ValueError:
        return None


def _image_files(folder: Path) -> list[Path]:
    """Return the PNG and JPEG files of a folder in natural order: img_9 before img_10.

    Raises InputError if there are none.
    """
    files = [
        path for path in folder.iterdir() if path.suffix.lower() in PICTURES and path.name[0] != "."
    ]
    if not files:
        raise InputError(f"folder has no images (expected {', '.join(PICTURES)})", folder)

    def sort_key(path: Path) -> list[str | int]:
        parts = re.split(r"(\d+)", path.stem)
        return [int(part) if part.isdecimal() else part for part in parts]

    return sorted(files, key=sort_key)


def check_numbers(files: Sequence[Path]) -> None:
    """Raise InputError if the last numbers in the names of images do not rise evenly.

    An image may be missing, or the images be those of two cameras. Names without numbers are not
    judged.
    """
    numbered = [path for path in files if re.search(r"\d", path.stem)]
    steps = np.diff([int(re.findall(r"\d+", path.stem)[-1]) for path in numbered])
    for step, before, after in zip(steps, numbered[:-1], numbered[1:], strict=True):
        if step != steps[0] or step <= 0:
            raise InputError(
                f"numbers in the names do not rise evenly: {after.name} follows {before.name}",
                before.parent,
                "Pass --times FILE, or a folder with the images of one camera",
            )


def _decode_frames(path: Path) -> Iterator[av.VideoFrame]:
    """Yield the images of a video from the first key frame on.

    Raises DamagedFile if it is cut short or has bad bytes.
    """
    fix = CONVERT.format(name=path.name)
    with _open_container(path) as (container, stream):
        stream.thread_type = "AUTO"
        packets = 0
        started = False
        # The end of all streams, as the duration in the header is that of the longest.
        end_s = 0.0
        for packet in container.demux():
            # A packet that is cut short, as the last one may be, does not count.
            if not packet.is_corrupt:
                packet_end = (packet.pts or 0) + (packet.duration or 0)
                end_s = max(end_s, float(packet_end * (packet.time_base or 0)))
            if packet.stream is not stream:
                continue
            packets += packet.size > 0
            started = started or packet.is_keyframe
            if not started:
                continue
            try:
                yield from stream.decode(packet)
            except av.FFmpegError as error:
                problem = f"is damaged at about image {packets}, {end_s:.1f} s"
                raise DamagedFile(problem, path, fix) from error

        total_s = (container.duration or 0) / av.time_base
        has_duration = container.format.name.split(",")[0] in _WITH_DURATION
        if has_duration and end_s < LEAST_SHARE * total_s - LAST_IMAGE_S:
            raise DamagedFile(f"ends after {end_s:.1f} of {total_s:.1f} s", path, fix)


@contextmanager
def _open_container(path: Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    """Yield an open file and its video stream, the default one if there are several.

    Raises DamagedFile, also if FFmpeg fails in the caller's `with` block.
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


def _rotate_upright(frame: av.VideoFrame, path: Path) -> np.ndarray:
    """Return the image RGB uint8 [H,W,3], rotated by its display matrix.

    Raises InputError for a matrix that does not turn by multiples of 90 degrees.
    """
    image = frame.to_ndarray(format="rgb24")
    display = cast(Any, frame.side_data.get("DISPLAYMATRIX"))
    if display is not None:
        # The matrix has the rows (a, b, u), (c, d, v) and (x, y, w). Rotations have a = d and
        # b = -c, and those by multiples of 90 degrees have a = 0 or b = 0.
        a, b, _, c, d, *_ = np.frombuffer(display, np.int32).tolist()
        if (a, b) != (d, -c) or (a and b):
            raise InputError(
                "display matrix mirrors the images or turns them by no multiple of 90 degrees",
                path,
                f"Apply it to the pixels: ffmpeg -i {path.name} -c:v libx264 upright.mp4",
            )
        image = np.rot90(image, frame.rotation // 90)
    return np.ascontiguousarray(image)
