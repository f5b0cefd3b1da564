"""From the clock of a car's sensors to the camera's: which images have motion, and what was interpolated."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.camera.footage import Footage, Image, ImageFolder
from pipeline.recording.track import Rates

ROUNDING_S = 1e-3  # of timestamps in videos, to which everything here holds


@dataclass(frozen=True)
class Coverage:
    """What of images' times [F] the motion's samples cover."""

    gap_s: np.ndarray
    """Between the samples around each image; 0 at a sample."""
    before: int
    """Images before the first sample."""
    after: int
    max_gap_s: float

    @property
    def kept(self) -> np.ndarray:
        """Whether an image has motion, bool [F]."""
        return self.gap_s <= self.max_gap_s + ROUNDING_S

    @property
    def in_gaps(self) -> int:
        return int((~self.kept).sum()) - self.before - self.after

    @property
    def interpolated(self) -> int:
        """How many images with motion lie between two samples."""
        return int((self.gap_s[self.kept] > 0).sum())

    @property
    def largest_gap_s(self) -> float:
        """The largest between two samples that was interpolated over."""
        return float(self.gap_s[self.kept].max(initial=0.0))


def coverage(rates: Rates, time_s: np.ndarray, max_gap_s: float) -> Coverage:
    """Say which images, taken at `time_s` [F], lie between samples that are no more than `max_gap_s` apart."""
    samples = rates.time_s
    before, after = time_s < samples[0] - ROUNDING_S, time_s > samples[-1] + ROUNDING_S
    left = np.clip(np.searchsorted(samples, time_s, side="right") - 1, 0, len(samples) - 2)
    gap_s = samples[left + 1] - samples[left]
    gap_s[(time_s == samples[left]) | (time_s == samples[left + 1])] = 0.0
    gap_s[before | after] = np.inf
    return Coverage(gap_s, int(before.sum()), int(after.sum()), max_gap_s)


def check_overlap(rates: Rates, first_s: float, last_s: float) -> None:
    """Raise InputError if images from `first_s` to `last_s` all lie outside of the motion's times."""
    begin, end = rates.time_s[0], rates.time_s[-1]
    if first_s <= end + ROUNDING_S and last_s >= begin - ROUNDING_S:
        return
    raise InputError(
        f"the images' times, {first_s:.3f} to {last_s:.3f} s, and the motion's, {begin:.3f} to {end:.3f} s, do not "
        f"overlap: --offset SECONDS is added to the motion's ({first_s - begin:+.3f} more makes both begin together)"
    )


def read_times(path: Path) -> np.ndarray:
    """Return the times of images, one number in seconds per line, float64 [F]. Raises InputError."""
    if not path.is_file():
        raise InputError(
            f"{path} is missing: --times wants a file with the time of each image in seconds, one per line"
        )
    lines = path.read_text(encoding="utf-8-sig", errors="replace").rstrip().split("\n")
    times = np.array([_number(line, path, number) for number, line in enumerate(lines, start=1)])
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        i = int(late[0])
        raise InputError(f"{path}: time goes from {lines[i]} to {lines[i + 1]} at line {i + 2}, it must increase")
    return times


def _number(line: str, path: Path, number: int) -> float:
    try:
        value = float(line)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{path}, line {number}: {line.strip() or 'nothing'} is not a number of seconds")
    return value


def timed(footage: Footage, times_s: np.ndarray | None) -> Iterator[tuple[float, Image]]:
    """Yield each image with its time in seconds, by its own clock if `times_s` [F] is None.

    Raises InputError if neither says a time, or there are not as many times as images.
    """
    if times_s is None:
        for image in footage.frames():
            if image.time_s is None:
                raise InputError(
                    f"{footage.path} does not say when its images were taken: say --fps N, or --times FILE with a line "
                    "for each"
                )
            yield image.time_s, image
        return
    if isinstance(footage, ImageFolder) and footage.count != len(times_s):  # a video's count is an estimate
        raise _miscounted(footage, footage.count, len(times_s))
    images = 0
    for images, image in enumerate(footage.frames(), start=1):
        if images <= len(times_s):
            yield float(times_s[image.number]), image
    if images != len(times_s):
        raise _miscounted(footage, images, len(times_s))


def _miscounted(footage: Footage, images: int, times: int) -> InputError:
    return InputError(f"{footage.path} has {images} images, and --times has {times} times: there must be one for each")
