"""Match the images' times with a log's: which images lie between samples that are close enough."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.files import MiB, read_bytes
from pipeline.camera.footage import Footage, Image, ImageFolder, open_footage
from pipeline.recording.track import check_times

ROUNDING_S = 1e-3  # of timestamps in videos; comparisons tolerate it
_MOST_BYTES = 128 * MiB  # of a file of times


def coverage(samples_s: np.ndarray, time_s: np.ndarray, max_gap_s: float) -> tuple[np.ndarray, dict[str, Any]]:
    """Find the images at `time_s` [F] that lie between samples at `samples_s` [N] that are at most `max_gap_s` apart.

    Returns: which images these are, bool [F]; and counts of images: ``interpolated`` between two samples, at most
    ``largest_gap_s`` apart; ``left_out`` before the first sample, after the last, and in longer gaps.
    """
    before, after = time_s < samples_s[0] - ROUNDING_S, time_s > samples_s[-1] + ROUNDING_S
    left = np.clip(np.searchsorted(samples_s, time_s, side="right") - 1, 0, len(samples_s) - 2)
    gap_s = samples_s[left + 1] - samples_s[left]
    gap_s[(time_s == samples_s[left]) | (time_s == samples_s[left + 1])] = 0.0
    inside = ~(before | after)
    usable = inside & (gap_s <= max_gap_s + ROUNDING_S)
    return usable, {
        "interpolated": int((gap_s[usable] > 0).sum()),
        "largest_gap_s": float(gap_s[usable].max(initial=0.0)),
        "left_out": {
            "before": int(before.sum()), "after": int(after.sum()), "in_gaps": int((inside & ~usable).sum())
        },
    }  # fmt: skip


def open_timed(path: Path, fps: float | None, times: Path | None) -> tuple[Footage, np.ndarray | None]:
    """Open a video or a folder of images, with `fps` images per second or with the times in a file, float64 [F]."""
    if fps and times:
        raise InputError("expected one source of the images' times, got two", fix="Pass --fps or --times")
    return open_footage(path, fps), read_times(times) if times else None


def read_times(path: Path) -> np.ndarray:
    """Return the times of images, one number in seconds per line, float64 [F]. Raises InputError."""
    if not path.is_file():
        raise InputError(
            "file is missing or not a regular file", path, "It holds a time in seconds per image, one per line"
        )
    try:
        times = np.array(read_bytes(path, _MOST_BYTES).decode("utf-8-sig", errors="replace").split(), np.float64)
    except ValueError as error:
        raise InputError(f"expected one number per line ({error})", path) from error
    if not len(times):
        raise InputError("file is empty (expected one number per line)", path)
    check_times(times, path)
    return times


def timed(footage: Footage, times_s: np.ndarray | None) -> Iterator[tuple[float, Image]]:
    """Yield each image with its time in seconds: from `times_s` [F], or its own if that is None.

    Raises InputError if images have no times, or if there are more or fewer than `times_s`.
    """
    if times_s is None:
        for image in footage.frames():
            if image.time_s is None:
                raise InputError("images have no times", footage.path, "Pass --fps N, or --times FILE")
            yield image.time_s, image
        return
    if isinstance(footage, ImageFolder):  # a video's count is an estimate
        _check_count(footage, footage.count, len(times_s))
    images = 0
    for images, image in enumerate(footage.frames(), start=1):
        if images <= len(times_s):
            yield float(times_s[image.number]), image
    _check_count(footage, images, len(times_s))


def _check_count(footage: Footage, images: int, times: int) -> None:
    if images != times:
        raise InputError(f"has {images} images, but --times has {times} lines (expected one each)", footage.path)
