"""The images of a recording and their times, from video files or a folder of images."""

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pandas as pd

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.images import Size, read_image
from pipeline.ingest.names import PICTURES, order_doubts, visible, words
from pipeline.ingest.video import CONVERT, Video, decode, probe, upright

# Largest difference in seconds between times of creation that may come from rounding: they are
# whole seconds.
WHOLE_S = 1.5


class ImageFolder:
    """The images of a folder, in order.

    Their times follow from a rate, or from names in nanoseconds.
    """

    # Number of images by a header. It is 0, as a folder has no header.
    stored = 0

    def __init__(self, folder: Path, fps: float | None) -> None:
        self.path = folder
        self.notes = list[str]()
        self.doubts = list[str]()
        self._files, places = _image_files(folder)
        self._times_s: np.ndarray | None = None
        if fps:
            self._times_s = places / fps
            missing = places[-1] + 1 - len(places)
            if missing:
                self.notes.append(
                    f"{missing} numbers are missing in the names of {len(places)} images: times "
                    "leave gaps"
                )
        elif all(re.fullmatch("[12][0-9]{18}", file.stem) for file in self._files):
            # Names are nanoseconds since 1970, which a float does not resolve.
            stamps_ns = [int(file.stem) for file in self._files]
            self._times_s = np.array([(stamp - stamps_ns[0]) / 1e9 for stamp in stamps_ns])

    def images(self) -> Iterator[av.VideoFrame]:
        """Yield the images; a second call starts again."""
        for file in self._files:
            yield av.VideoFrame.from_ndarray(read_image(file), "rgb24")

    def span_s(self) -> tuple[float, float]:
        """Return the times of the first and the last image, without decoding.

        Raises InputError if the images have no times.
        """
        times_s = self.times_s()
        return float(times_s[0]), float(times_s[-1])

    def times_s(self, stamps_s: np.ndarray | None = None) -> np.ndarray:
        """Return the times of the images [N].

        The argument is only for videos, as the images of a folder have no time stamps.
        """
        if self._times_s is None:
            raise _without_times(self.path)
        return self._times_s


class VideoFiles:
    """Videos that follow each other.

    The times of their images are the time stamps in the files, or follow from a rate.
    """

    def __init__(self, paths: Sequence[Path], fps: float | None) -> None:
        self.path = paths[0]
        self._fps = fps
        self._videos = [probe(path) for path in paths]
        self._begins_s, gaps = follow(self._videos)
        # Number of images by the headers; a file whose header does not say it counts as 0.
        self.stored = sum(video.stored for video in self._videos)
        self.notes = [note for video in self._videos for note in video.notes] + gaps
        # Doubts whether the files are one recording, in order. Times of creation are only compared
        # if the names of the files raise no doubt.
        self.doubts = order_doubts(paths) if len(paths) > 1 else []
        if not self.doubts:
            self.doubts = [*_created_earlier(self._videos)]

    def images(self) -> Iterator[av.VideoFrame]:
        """Yield the images; a second call starts again."""
        # Time stamps of all files are shifted to continue those of the first.
        first_s = self._videos[0].first_s
        for video, begin_s in zip(self._videos, self._begins_s, strict=True):
            yield from decode(video.path, begin_s + first_s - video.first_s)

    def span_s(self) -> tuple[float, float]:
        """Return the times of the first and the last image, without decoding.

        Raises InputError if the images have no times, and for time lapse or slow motion, whose
        times are not those at which the images were taken.
        """
        if self._fps:
            count = sum(video.packets for video in self._videos)
            return 0.0, (count - 1) / self._fps
        if not all(video.stamped for video in self._videos):
            raise _without_times(self.path)
        first = self._videos[0]
        # The comparison is false for NaN, which is neither time lapse nor slow motion.
        if first.taken_hz > 0:
            raise InputError(
                f"time lapse or slow motion: {first.taken_hz:g} images per second were taken, "
                f"{1 / first.step_s:.4g} are stored",
                self.path,
                f"Pass --fps {first.taken_hz:g}",
            )
        return 0.0, self._begins_s[-1] + self._videos[-1].length_s

    def times_s(self, stamps_s: np.ndarray) -> np.ndarray:
        """Return the times of the images [N] by their time stamps.

        Raises DamagedFile if the time stamps do not increase.
        """
        if self._fps:
            return np.arange(len(stamps_s)) / self._fps
        times_s = stamps_s - stamps_s[0]
        increases = np.diff(times_s) > 0
        if not increases.all():
            raise DamagedFile(
                f"timestamps do not increase at image {increases.argmin() + 1}",
                self.path,
                "If the file is not damaged there, pass --fps",
            )
        return times_s


def _without_times(path: Path) -> InputError:
    return InputError("images have no times", path, "Pass --fps N, or --times FILE")


def follow(videos: Sequence[Video]) -> tuple[list[float], list[str]]:
    """Return the time at which each video begins, the first at 0, and notes on gaps and overlaps.

    Files of one recording follow each other, unless the times at which they were created say
    otherwise.
    """
    begins_s = [0.0]
    notes = list[str]()
    for before, after in pairwise(videos):
        duration_s = before.length_s + before.step_s
        begin_s = begins_s[-1] + duration_s

        # Times of creation show a gap, or an overlap, if they are known and in order.
        gap_s = 0.0
        apart_s = _created_after_s(before, after)
        if apart_s > 0:
            gap_s = apart_s - duration_s
        if abs(gap_s) > WHOLE_S:
            when = "after" if gap_s > 0 else "before"
            notes.append(
                f"{after.path.name} begins {abs(gap_s):.1f} s {when} the end of {before.path.name}"
            )
        # An overlap gets a note only, as times have to increase.
        if gap_s > WHOLE_S:
            begin_s += gap_s
        begins_s.append(begin_s)
    return begins_s, notes


def _created_earlier(videos: Sequence[Video]) -> Iterator[str]:
    """Yield a doubt for each video that was created before the one that it follows."""
    for before, after in pairwise(videos):
        early_s = -_created_after_s(before, after)
        if early_s > WHOLE_S:
            yield (
                f"{after.path.name} follows {before.path.name}, but was created {early_s:.0f} s "
                "earlier: is the order of the files right?"
            )


def _created_after_s(before: Video, after: Video) -> float:
    """Return the seconds between the creation of two videos; NaN if one is unknown."""
    return float((after.created - before.created) / pd.Timedelta(seconds=1))


def image_size(source: ImageFolder | VideoFiles) -> Size:
    """Return the size of the first image. Raises DamagedFile if there is none."""
    first = next(iter(source.images()), None)
    if first is None:
        raise DamagedFile("video has no frames", source.path, CONVERT.format(name=source.path.name))
    return upright(first, source.path).shape[:2]


def _image_files(folder: Path) -> tuple[list[Path], np.ndarray]:
    """Return the PNG and JPEG files of a folder in order, and their places [F].

    A place is the position of an image among all images that were taken: it skips a missing number.
    If names have no regular numbers, the places are 0, 1, and so on.
    """
    files = visible(folder, PICTURES)
    if not files:
        raise InputError(f"folder has no images (expected {', '.join(PICTURES)})", folder)

    # The numbers in the names of one camera's images, every second word, rise from file to file.
    for before, after in pairwise(files):
        numbers_before = words(before)[1::2]
        if numbers_before and words(after)[1::2] <= numbers_before:
            raise InputError(
                f"{after.name} would follow {before.name}: images of two cameras, or in two "
                "formats?",
                folder,
                "Pass a folder with the images of one",
            )

    # The last number counts the images only if the names differ in nothing else.
    in_order = np.arange(len(files))
    names = [words(file) for file in files]
    if len({(*name[:-2], name[-1]) for name in names}) > 1:
        return files, in_order

    # It must also rise regularly: the smallest step is the median of all steps, and the others are
    # multiples of it.
    numbers = [int(name[-2]) for name in names if len(name) > 1]
    steps = [after - before for before, after in pairwise(numbers)]
    step = min(steps, default=0)
    if step <= 0 or step != sorted(steps)[len(steps) // 2] or any(gap % step for gap in steps):
        return files, in_order
    return files, np.array([(number - numbers[0]) // step for number in numbers])
