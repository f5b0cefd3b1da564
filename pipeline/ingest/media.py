"""Read the images of a recording, from video files or a folder of images, and look at all of them
once.
"""

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, cast

import av
import numpy as np
import pandas as pd
from av.container import InputContainer
from av.stream import Disposition
from av.video.reformatter import VideoReformatter
from av.video.stream import VideoStream
from tqdm import tqdm

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.images import Size, format_size, read_image
from pipeline.ingest.names import PICTURES, order_doubts, visible, words
from pipeline.ingest.stereo import likeness, refuse_stereo

_CONVERT = "Copy the file again, or convert it: ffmpeg -i {name} -c:v libx264 converted.mp4"
# Playlists, scripts and session descriptions can open other files and sockets. So only containers
# and streams of frames are accepted, and no protocol: FFmpeg reads the file that is already open.
_WITHOUT_TIMES = ("h264", "hevc", "m4v", "mpegvideo", "mjpeg", "obu")
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
_OPTIONS = {
    "format_whitelist": ",".join((*_CONTAINERS, *_WITHOUT_TIMES)),
    "protocol_whitelist": "none",
    "enable_drefs": "0",  # references of MOV files to other files
    "use_absolute_path": "0",
}
Images = Iterator[av.VideoFrame]
# grey levels: at most BAR in MOST pixels of a black bar's row, above LIT 2 rows beside it
BAR, LIT, MOST = 8, 32, 0.95
STRIDE = 20  # of the images that are searched for black bars, and for two images of a stereo camera
THUMB_PX = 64  # width of the images that are compared: averages noise
# least share of the header's count of frames in a complete file, which may also lack one
INEXACT = 0.99
PLAYED = 1.2  # times faster or slower than taken, at most
# of the median step, between the 5th and the 95th percentile: phones in the dark slow down unevenly
STEADY = 0.1
WHOLE_S = 1.5  # files' times of creation are in whole seconds
LAST_S = 0.2  # longest duration of a last image whose duration the file does not store

# Seconds before damage that are left out, too: threads decode some images after the one that fails.
BEFORE_S = 2.0


class _Video(NamedTuple):
    """What the container of a video says, without decoding."""

    path: Path
    stored: int  # frames by the header, 0: unknown
    packets: int
    stamped: bool
    first_s: float
    length_s: float  # between the first and the last frame
    step_s: float
    created: pd.Timestamp  # NaT: unknown
    # images per second by the phone's tag, where they are stored at another steady rate; else NaN
    taken_hz: float
    notes: list[str]


class ImageFolder:
    """The images of a folder, in order; their times follow from a rate, or from names in
    nanoseconds.
    """

    stored = 0  # images by a header

    def __init__(self, folder: Path, fps: float | None) -> None:
        self.path = folder
        self.notes = list[str]()
        self.doubts = list[str]()
        self._files, places = _image_files(folder)
        self._times_s: np.ndarray | None = None
        if fps:
            self._times_s = places / fps
            if missing := places[-1] + 1 - len(places):
                self.notes.append(
                    f"{missing} numbers are missing in the names of {len(places)} images: times "
                    "leave gaps"
                )
        elif all(re.fullmatch("[12][0-9]{18}", file.stem) for file in self._files):  # ns since 1970
            first = int(self._files[0].stem)
            self._times_s = np.array([(int(file.stem) - first) / 1e9 for file in self._files])

    def images(self) -> Images:
        """Yield the images; a second call starts again."""
        return (av.VideoFrame.from_ndarray(read_image(file), "rgb24") for file in self._files)

    def span_s(self) -> tuple[float, float]:
        """Return the times of the first and the last image, without decoding. Raises InputError
        without times.
        """
        if self._times_s is None:
            raise _without_times(self.path)
        return float(self._times_s[0]), float(self._times_s[-1])

    def times_s(self, stamps_s: np.ndarray) -> np.ndarray:
        """Return the times of the images [N], which have no time stamps of their own."""
        if self._times_s is None:
            raise _without_times(self.path)
        return self._times_s


class VideoFiles:
    """Videos that follow each other; their times are their own, or follow from a rate."""

    def __init__(self, paths: Sequence[Path], fps: float | None) -> None:
        self.path = paths[0]
        self._fps = fps
        self._videos = [_probe(path) for path in paths]
        self._begins_s, gaps = _follow(self._videos)
        # images by the headers, 0: unknown
        self.stored = sum(video.stored for video in self._videos)
        self.notes = [note for video in self._videos for note in video.notes] + gaps
        # whether this is one recording, in order
        self.doubts = order_doubts(paths) if len(paths) > 1 else []
        self.doubts = self.doubts or [*_created_earlier(self._videos)]

    def images(self) -> Images:
        """Yield the images; a second call starts again."""
        first_s = self._videos[0].first_s
        for video, begin_s in zip(self._videos, self._begins_s, strict=True):
            yield from _decode(video.path, begin_s + first_s - video.first_s)

    def span_s(self) -> tuple[float, float]:
        """Return the times of the first and the last image, without decoding.

        Raises InputError without times, and for time lapse or slow motion, whose times are not
        those of the camera.
        """
        first = self._videos[0]
        if self._fps:
            return 0.0, (sum(video.packets for video in self._videos) - 1) / self._fps
        if not all(video.stamped for video in self._videos):
            raise _without_times(self.path)
        if first.taken_hz > 0:  # false for NaN
            rates = (
                f"{first.taken_hz:g} images per second were taken, {1 / first.step_s:.4g} are "
                "stored"
            )
            raise InputError(
                f"time lapse or slow motion: {rates}", self.path, f"Pass --fps {first.taken_hz:g}"
            )
        return 0.0, self._begins_s[-1] + self._videos[-1].length_s

    def times_s(self, stamps_s: np.ndarray) -> np.ndarray:
        """Return the times of the images [N] by their time stamps. Raises DamagedFile if these do
        not increase.
        """
        if self._fps:
            return np.arange(len(stamps_s)) / self._fps
        times_s = stamps_s - stamps_s[0]
        increases = np.diff(times_s) > 0
        if not increases.all():
            fix = "If the file is not damaged there, pass --fps"
            raise DamagedFile(
                f"timestamps do not increase at image {increases.argmin() + 1}", self.path, fix
            )
        return times_s


def _without_times(path: Path) -> InputError:
    return InputError("images have no times", path, "Pass --fps N, or --times FILE")


def _probe(path: Path) -> _Video:
    """Read a video's container. Raises InputError if pixels are not square."""
    with _container(path) as (container, (stream, *others)):
        shape, base = float(stream.sample_aspect_ratio or 1), stream.time_base or 1
        # elsewhere FFmpeg assumes 25 frames per second
        stamped = container.format.name not in _WITHOUT_TIMES
        # without decoding
        stamps = [packet.pts for packet in container.demux(stream) if packet.size]
        known = sorted(stamp for stamp in stamps if stamp is not None) or [0]
        steps = np.diff(known) if len(known) > 1 else np.zeros(1)
        first_s, length_s, step_s = (
            float(x * base) for x in (known[0], known[-1] - known[0], int(np.median(steps)))
        )
        taken_hz = float(
            pd.to_numeric(container.metadata.get("com.android.capture.fps"), errors="coerce")
        )
        low, high = np.percentile(steps, [5, 95])
        if (
            (high - low) * base > STEADY * step_s
            or 1 / PLAYED < taken_hz * step_s < PLAYED
            or not step_s
        ):
            taken_hz = math.nan
        notes, created = (
            list[str](),
            pd.to_datetime(container.metadata.get("creation_time"), errors="coerce"),
        )
        if others:
            name, *names = (
                f"{one.index} ({one.width} x {one.height} pixels)" for one in (stream, *others)
            )
            notes.append(f"video stream {name} is used, not {', '.join(names)}")
        video = _Video(
            path,
            stream.frames,
            len(stamps),
            stamped,
            first_s,
            length_s,
            step_s,
            created,
            taken_hz,
            notes,
        )
    if abs(shape - 1) > 0.01:
        fix = f"Scale it: ffmpeg -i {path.name} -vf scale=iw*sar:ih,setsar=1 square.mp4"
        raise InputError(f"pixels are not square ({shape:.3f} times as wide as high)", path, fix)
    return video


def _follow(videos: Sequence[_Video]) -> tuple[list[float], list[str]]:
    """Return the time at which each video begins, the first at 0, and notes on gaps and overlaps.

    Files of one recording follow each other, unless the times at which they were created say
    otherwise.
    """
    begins_s, notes = [0.0], list[str]()
    for before, after in pairwise(videos):
        whole_s, gap_s = before.length_s + before.step_s, 0.0
        # false for NaT
        if (apart_s := (after.created - before.created) / pd.Timedelta(seconds=1)) > 0:
            gap_s = apart_s - whole_s
        if abs(gap_s) > WHOLE_S:
            when = "after" if gap_s > 0 else "before"
            notes.append(
                f"{after.path.name} begins {abs(gap_s):.1f} s {when} the end of {before.path.name}"
            )
        begins_s.append(begins_s[-1] + whole_s + (gap_s if gap_s > WHOLE_S else 0.0))
    return begins_s, notes


def _created_earlier(videos: Sequence[_Video]) -> Iterator[str]:
    """Yield a doubt for each video that was created before the one that it follows."""
    for before, after in pairwise(videos):
        early_s = (before.created - after.created) / pd.Timedelta(seconds=1)
        if early_s > WHOLE_S:  # false for NaT
            created = (
                f"{after.path.name} follows {before.path.name}, but was created {early_s:.0f} s "
                "earlier"
            )
            yield f"{created}: is the order of the files right?"


def image_size(source: ImageFolder | VideoFiles) -> Size:
    """Return the size of the first image. Raises DamagedFile if there is none."""
    first = next(iter(source.images()), None)
    if first is None:
        raise DamagedFile(
            "video has no frames", source.path, _CONVERT.format(name=source.path.name)
        )
    return upright(first, source.path).shape[:2]


def scan(source: ImageFolder | VideoFiles) -> tuple[pd.DataFrame, list[str]]:
    """Return time stamps, NaN: none, and `change` and `key` of :func:`repeats` of all images, a row
    each; and notes.

    Raises InputError if the size changes, or if images are those of a stereo camera.
    """
    shrink = VideoReformatter()
    rows = []
    before = np.array(np.inf)
    shape: Size = (0, 0)
    likenesses = list[tuple[float, float]]()
    for number, image in enumerate(tqdm(source.images(), "scan", unit=" images", disable=None)):
        if number == 0:
            shape = image.height, image.width
            light = np.zeros(shape, np.uint8)
            small = min(THUMB_PX, shape[1]), max(1, shape[0] * THUMB_PX // shape[1])
        if (image.height, image.width) != shape:
            sizes = (
                f"{image.width} x {image.height} pixels (expected {format_size(shape)}, as the "
                "first one)"
            )
            raise InputError(
                f"image {number} has {sizes}", source.path, "Images of one recording have one size"
            )
        grey = (
            shrink.reformat(image, *small, "gray", interpolation="AREA")
            .to_ndarray()
            .astype(np.float32)
        )
        rows.append(
            (image.time, np.abs(grey - before).mean(), image.key_frame, image.interlaced_frame)
        )
        before = grey
        if number % STRIDE == 0:
            sample = image.to_ndarray(format="gray")
            light = np.maximum(light, sample)
            likenesses.append(likeness(sample))
    refuse_stereo(np.array(likenesses), source.path)
    table = pd.DataFrame(np.array(rows, float), columns=["time_s", "change", "key", "interlaced"])
    fix = f"ffmpeg -i {source.path.name} -vf bwdif=send_frame progressive.mp4"
    fields = (
        [f"interlaced images falsify the motion. Deinterlace them: {fix}"]
        if table.pop("interlaced").any()
        else []
    )
    return table, fields + _bars(light, source.path)


def _bars(light: np.ndarray, path: Path) -> list[str]:
    """Return a note on black bars on two opposite sides of images; `light` [H,W]: their lightest
    values.
    """
    crop = list[int]()
    for axis in (0, 1):
        level = np.quantile(light, MOST, axis=axis)
        first, last = np.flatnonzero(level > BAR)[[0, -1]] if level.max() > BAR else (0, 0)
        bars = first > 2 and last < len(level) - 3 and min(level[first + 2], level[last - 2]) > LIT
        crop += [last + 1 - first, first] if bars else [len(level), 0]
    width, left, height, top = crop
    fix = (
        f"ffmpeg -i {path.name} -vf crop={width}:{height}:{left}:{top} cropped.mp4, cx - {left} "
        f"and cy - {top} in --K"
    )
    return (
        []
        if (height, width) == light.shape
        else [f"black bars make the speed wrong. Crop the images: {fix}"]
    )


def _decode(path: Path, shift_s: float) -> Images:
    """Yield the images of a video from the first key frame on. Raises DamagedFile if it is cut
    short or has bad bytes.

    `shift_s` is added to their times. The edit list of an MP4 or MOV file may leave out stored
    frames; then the others last as long as the header says. Matroska has no count of frames, but a
    duration, that of its longest stream.
    """
    with _container(path) as (container, (stream, *_)):
        stream.thread_type = "AUTO"
        stored, packets, started, end_s = stream.frames, 0, False, 0.0
        begin_s = float((stream.start_time or 0) * (stream.time_base or 0))
        for packet in container.demux():
            if not packet.is_corrupt:  # cut short
                end_s = max(
                    end_s,
                    float(((packet.pts or 0) + (packet.duration or 0)) * (packet.time_base or 0)),
                )
            if packet.stream is stream:
                packets += packet.size > 0
                if started := started or packet.is_keyframe:
                    time_s = float((packet.pts or 0) * (packet.time_base or 0)) - begin_s
                    with _place_of_damage(path, packets, time_s):
                        decoded = stream.decode(packet)
                    for image in decoded:
                        if shift_s and image.pts is not None and image.time_base:
                            image.pts += round(shift_s / image.time_base)
                        yield image
        total_s, kind = (container.duration or 0) / av.time_base, container.format.name
        cut = packets < INEXACT * stored - 1
        if "matroska" in kind or (cut and "mov" in kind):
            cut = end_s < INEXACT * total_s - LAST_S
        if cut:
            end = f"{packets} of {stored} frames" if stored else f"{end_s:.1f} of {total_s:.1f} s"
            raise DamagedFile(f"ends after {end}", path, _CONVERT.format(name=path.name))


@contextmanager
def _place_of_damage(path: Path, number: int, time_s: float) -> Iterator[None]:
    """Raise DamagedFile for an error in the block, which decodes the packet of about image
    `number`.
    """
    try:
        yield
    except av.FFmpegError as error:
        copy = "Copy the file again"
        if time_s > 2 * BEFORE_S:
            copy += (
                f", or use the part before: ffmpeg -i {path.name} -t {int(time_s - BEFORE_S)} -c "
                "copy start.mp4"
            )
        raise DamagedFile(
            f"is damaged at about image {number}, {time_s:.1f} s", path, copy
        ) from error


@contextmanager
def _container(path: Path) -> Iterator[tuple[InputContainer, list[VideoStream]]]:
    """Yield an open file and its video streams, the default first. Raises DamagedFile, also for
    errors in the block.
    """
    with path.open("rb") as file:  # FFmpeg interprets some names as addresses or patterns
        try:
            with av.open(file, "r", options=_OPTIONS, metadata_errors="replace") as container:
                streams = [
                    one
                    for one in container.streams.video
                    if not one.disposition & Disposition.attached_pic
                ]
                if not streams:
                    raise DamagedFile("file has no video stream", path)
                streams.sort(key=lambda one: not one.disposition & Disposition.default)
                yield container, streams
        except (av.FFmpegError, OSError) as error:
            problem = (
                "cannot be decoded as a video (expected a container like MP4, MOV, Matroska, AVI "
                "or MPEG)"
            )
            raise DamagedFile(problem, path, _CONVERT.format(name=path.name)) from error


def upright(frame: av.VideoFrame, path: Path) -> np.ndarray:
    """Return the image RGB uint8 [H,W,3], rotated by its display matrix. Raises InputError for
    other matrices.
    """
    image, display = (
        frame.to_ndarray(format="rgb24"),
        cast(Any, frame.side_data.get("DISPLAYMATRIX")),
    )
    if display is not None:
        a, b, _, c, d, *_ = np.frombuffer(display, np.int32).tolist()
        if (a, b) != (d, -c) or (a and b):
            fix = f"Apply it to the pixels: ffmpeg -i {path.name} -c:v libx264 upright.mp4"
            raise InputError(
                "display matrix mirrors the images or turns them by no multiple of 90 degrees",
                path,
                fix,
            )
        image = np.rot90(image, frame.rotation // 90)
    return np.ascontiguousarray(image)


def _image_files(folder: Path) -> tuple[list[Path], np.ndarray]:
    """Return the PNG and JPEG files of a folder in order, and their places [F].

    Places leave room for missing numbers; of names without consecutive numbers they are 0, 1, …
    """
    if not (files := visible(folder, PICTURES)):
        raise InputError(f"folder has no images (expected {', '.join(PICTURES)})", folder)
    parts = {path: words(path) for path in files}
    for before, after in pairwise(files):
        if parts[before][1:] and parts[after][1::2] <= parts[before][1::2]:
            problem = (
                f"{after.name} would follow {before.name}: images of two cameras, or in two "
                "formats?"
            )
            raise InputError(problem, folder, "Pass a folder with the images of one")
    numbers = [parts[path][-2] for path in files if parts[path][1:]]
    steps = [after - before for before, after in pairwise(numbers)] or [0]
    names = {(*parts[path][:-2], parts[path][-1]) for path in files}  # apart from the last number
    if (
        len(names) > 1
        or not 0 < (step := min(steps)) == sorted(steps)[len(steps) // 2]
        or any(n % step for n in steps)
    ):
        return files, np.arange(len(files))
    return files, np.array([(number - numbers[0]) // step for number in numbers])
