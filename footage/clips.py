"""Describe the files of a recording, and find gaps between them by their dates.

A dashcam loses some time between two files, but no file says how much. Its date, in the name or the
tag creation_time, has whole seconds, and is sometimes that of the end. So it is printed, and
shifts nothing.
"""

import re
from collections.abc import Sequence
from datetime import datetime
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from footage.video import Images
from pipeline.base.summary import DOUBT

# Longest gap or overlap in seconds between two files that is no doubt, as dates have whole seconds.
LONGEST_GAP_S = 2.0
# Sources of a file's date, as messages name them.
TAG = "creation_time"
NAME = "the file's name"
# A date with four digits of the year, and a time, in the name of a file.
_DATE = re.compile(r"(?<!\d)(20\d\d)\D?(\d\d)\D?(\d\d)\D{0,3}(\d\d)\D?(\d\d)\D?(\d\d)")


class Clip(NamedTuple):
    """A file of a recording, and when it begins and ends."""

    name: str
    images: int
    # Time in the recording, by the images' times.
    begin_s: float
    end_s: float
    # Source → date and time of the file's begin or end, without a time zone.
    dates: dict[str, datetime]


class Gap(NamedTuple):
    """The time between the end of a file and the begin of the next; negative if they overlap."""

    before: str
    after: str
    length_s: float


def list_clips(files: Sequence[Images], times_s: np.ndarray) -> list[Clip]:
    """Return the files of a recording. `times_s` [N] are those of all their images."""
    step_s = float(np.median(np.diff(times_s)))
    clips = []
    start = 0
    for file in files:
        clip_s = times_s[start : start + file.count]
        start += file.count
        dates = {TAG: file.created, NAME: parse_date(file.path.name)}
        known_dates = {source: date for source, date in dates.items() if date}
        # The last image lasts until the next file begins.
        end_s = float(clip_s[-1]) + step_s
        clips.append(Clip(file.path.name, file.count, float(clip_s[0]), end_s, known_dates))
    return clips


def parse_date(name: str) -> datetime | None:
    """Return the date and time in the name of a file, such as 20260131_235959.mp4."""
    match = _DATE.search(name)
    try:
        return datetime.strptime("".join(match.groups()), "%Y%m%d%H%M%S") if match else None
    except ValueError:
        return None


def describe_clips(clips: Sequence[Clip]) -> list[str]:
    """Return a line for each file: its length, when it is taken to begin, and its dates."""
    lines = []
    for clip in clips:
        dates = "".join(
            f"; {source} says {date:%Y-%m-%d %H:%M:%S}" for source, date in clip.dates.items()
        )
        length = f"{clip.images:,} images, {clip.end_s - clip.begin_s:.1f} s"
        lines.append(f"{clip.name}: {length}, taken to begin at {clip.begin_s:.1f} s{dates}")
    return lines


def find_gaps(clips: Sequence[Clip]) -> list[str]:
    """Return doubts about gaps and overlaps of more than LONGEST_GAP_S, one for each source."""
    doubts = []
    for source in (TAG, NAME):
        gaps = [gap for gap in _measure_gaps(clips, source) if abs(gap.length_s) > LONGEST_GAP_S]
        if not gaps:
            continue
        before, after, length_s = gaps[0]
        what = f"{length_s:.0f} s are missing between {before} and {after}"
        if length_s < 0:
            what = f"{after} begins {-length_s:.0f} s before the end of {before}"
        more = f" (and {len(gaps) - 1} more)" if len(gaps) > 1 else ""
        doubts.append(
            f"{DOUBT}by {source}, {what}{more}, but each file is taken to begin one image after "
            "the one before. Pass --times FILE, the seconds of each image"
        )
    return doubts


def _measure_gaps(clips: Sequence[Clip], source: str) -> list[Gap]:
    """Return the gaps between the files that have a date of the `source`.

    Dates are those of the begins or of the ends, whichever leaves less. A date that all files share
    is none of their own: tools that cut a video copy the tag.
    """
    dated = [clip for clip in clips if source in clip.dates]
    if len({clip.dates[source] for clip in dated}) < 2:
        return []
    by_begin = []
    by_end = []
    for before, after in pairwise(dated):
        passed_s = (after.dates[source] - before.dates[source]).total_seconds()
        begin_s = passed_s - (after.begin_s - before.begin_s)
        end_s = passed_s - (after.end_s - before.end_s)
        by_begin.append(Gap(before.name, after.name, begin_s))
        by_end.append(Gap(before.name, after.name, end_s))
    return min(by_begin, by_end, key=lambda gaps: sum(abs(gap.length_s) for gap in gaps))
