"""Read a video file: facts in its container, and its images."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, cast

import av
import numpy as np
import pandas as pd
from av.container import InputContainer
from av.stream import Disposition
from av.video.stream import VideoStream

from pipeline.base.errors import DamagedFile, InputError

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
# Largest ratio between the rate at which images were taken and the rate at which they are stored,
# in either direction. Beyond it, the video is time lapse or slow motion.
PLAYED = 1.2
# Largest distance between the 5th and the 95th percentile of the steps at a steady rate, as a share
# of the median step. Phones in the dark slow down unevenly.
STEADY = 0.1
# Seconds before the reported damage that the advice leaves out, too. Decoding runs in several
# threads, so damage is reported some images late.
BEFORE_S = 2.0


class Video(NamedTuple):
    """The facts of a video's container, which are read without decoding."""

    path: Path
    stored: int  # number of frames by the header; 0 if unknown
    packets: int  # number of packets that are not empty
    stamped: bool  # whether images have time stamps
    first_s: float  # time stamp of the first frame
    length_s: float  # time between the first and the last frame
    step_s: float  # median time between two frames
    created: pd.Timestamp  # NaT if unknown
    # Rate at which images were taken, in images per second, by a tag that phones write. It is NaN
    # unless the video is stored at a steady rate that differs from it.
    taken_hz: float
    notes: list[str]  # for the user


def probe(path: Path) -> Video:
    """Return the facts of a video's container. Raises InputError if pixels are not square."""
    with _container(path) as (container, streams):
        stream = streams[0]
        stored = stream.frames
        shape = float(stream.sample_aspect_ratio or 1)
        unit_s = stream.time_base or 1
        # For streams without a container, FFmpeg assumes 25 frames per second.
        stamped = container.format.name not in _WITHOUT_TIMES
        stamps = [packet.pts for packet in container.demux(stream) if packet.size]
        created = container.metadata.get("creation_time")
        tagged_hz = container.metadata.get("com.android.capture.fps")
        notes = _ignored_streams(streams)
    if abs(shape - 1) > SQUARE:
        fix = f"Scale it: ffmpeg -i {path.name} -vf scale=iw*sar:ih,setsar=1 square.mp4"
        raise InputError(f"pixels are not square ({shape:.3f} times as wide as high)", path, fix)

    ascending = sorted(stamp for stamp in stamps if stamp is not None) or [0]
    steps = np.diff(ascending) if len(ascending) > 1 else np.zeros(1)
    step_s = float(int(np.median(steps)) * unit_s)

    # The phone's tag matters only if the stored rate is steady, and differs from the tag.
    taken_hz = float(pd.to_numeric(tagged_hz, errors="coerce"))
    low, high = np.percentile(steps, [5, 95])
    uneven = (high - low) * unit_s > STEADY * step_s
    if uneven or not step_s or 1 / PLAYED < taken_hz * step_s < PLAYED:
        taken_hz = math.nan

    return Video(
        path,
        stored,
        packets=len(stamps),
        stamped=stamped,
        first_s=float(ascending[0] * unit_s),
        length_s=float((ascending[-1] - ascending[0]) * unit_s),
        step_s=step_s,
        created=pd.to_datetime(created, errors="coerce"),
        taken_hz=taken_hz,
        notes=notes,
    )


def _ignored_streams(streams: Sequence[VideoStream]) -> list[str]:
    """Return a note on the video streams that are not used, which are all but the first."""
    used, *ignored = [
        f"{stream.index} ({stream.width} x {stream.height} pixels)" for stream in streams
    ]
    if not ignored:
        return []
    return [f"video stream {used} is used, not {', '.join(ignored)}"]


def decode(path: Path, shift_s: float) -> Iterator[av.VideoFrame]:
    """Yield the images of a video from the first key frame on; `shift_s` is added to their times.

    Raises DamagedFile if it is cut short or has bad bytes.
    """
    with _container(path) as (container, streams):
        stream = streams[0]
        stream.thread_type = "AUTO"
        stored = stream.frames
        begin_s = float((stream.start_time or 0) * (stream.time_base or 0))
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

            time_s = float((packet.pts or 0) * unit_s) - begin_s
            with _place_of_damage(path, packets, time_s):
                images = stream.decode(packet)
            for image in images:
                if shift_s and image.pts is not None and image.time_base:
                    image.pts += round(shift_s / image.time_base)
                yield image
        _check_complete(container, path, stored, packets, end_s)


def _check_complete(
    container: InputContainer, path: Path, stored: int, packets: int, end_s: float
) -> None:
    """Raise DamagedFile if a file ends before its header says so.

    The header says that the file has `stored` images, and `packets` of them were read. The last
    packet of all streams ends at `end_s`.

    The edit list of an MP4 or MOV file may leave out stored frames. Such a file is complete if its
    duration is that of the header. The header of a Matroska file does not have the number of
    frames, but the duration of the longest stream.
    """
    is_cut = packets < INEXACT * stored - 1
    total_s = (container.duration or 0) / av.time_base
    kind = container.format.name
    if "matroska" in kind or (is_cut and "mov" in kind):
        is_cut = end_s < INEXACT * total_s - LAST_S
    if is_cut:
        end = f"{packets} of {stored} frames" if stored else f"{end_s:.1f} of {total_s:.1f} s"
        raise DamagedFile(f"ends after {end}", path, CONVERT.format(name=path.name))


@contextmanager
def _place_of_damage(path: Path, number: int, time_s: float) -> Iterator[None]:
    """Raise DamagedFile if FFmpeg fails in the block, which decodes about image `number`."""
    try:
        yield
    except av.FFmpegError as error:
        problem = f"is damaged at about image {number}, {time_s:.1f} s"
        fix = "Copy the file again"
        if time_s > 2 * BEFORE_S:
            before_s = int(time_s - BEFORE_S)
            part = f"ffmpeg -i {path.name} -t {before_s} -c copy start.mp4"
            fix = f"{fix}, or use the part before: {part}"
        raise DamagedFile(problem, path, fix) from error


@contextmanager
def _container(path: Path) -> Iterator[tuple[InputContainer, list[VideoStream]]]:
    """Yield an open file and its video streams, the default first.

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
                yield container, streams
        except (av.FFmpegError, OSError) as error:
            raise DamagedFile(
                "cannot be decoded as a video (expected a container like MP4, MOV, Matroska, AVI "
                "or MPEG)",
                path,
                CONVERT.format(name=path.name),
            ) from error


def upright(frame: av.VideoFrame, path: Path) -> np.ndarray:
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
