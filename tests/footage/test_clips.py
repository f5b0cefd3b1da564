"""Dates of a recording's files: what they say, and gaps between them."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from footage.clips import describe_clips, find_gaps, list_clips, parse_date
from footage.video import Images
from pipeline.base.summary import DOUBT


@pytest.mark.parametrize(
    ("name", "date"),
    [
        ("20260131_235959.mp4", datetime(2026, 1, 31, 23, 59, 59)),
        ("2026_0131_235959_001F.MP4", datetime(2026, 1, 31, 23, 59, 59)),
        ("2026-01-31_23-59-59-front.mp4", datetime(2026, 1, 31, 23, 59, 59)),
        ("PXL_20260131_235959123.mp4", datetime(2026, 1, 31, 23, 59, 59)),
        ("NO20260131-235959-000012.MP4", datetime(2026, 1, 31, 23, 59, 59)),
        ("20261331_235959.mp4", None),
        ("2011_09_26_drive_0001.mp4", None),
        ("GX010042.MP4", None),
    ],
)
def test_dates_in_names(name, date):
    assert parse_date(name) == date


def doubts(names: Sequence[str], created: Sequence[int | None] = (), last: int = 60) -> list[str]:
    """Return the doubts about files of a minute; the last one has so many seconds.

    `created` are the seconds of their tags.
    """
    files = []
    for place, name in enumerate(names):
        count = last if place == len(names) - 1 else 60
        second = created[place] if created else None
        date = None if second is None else datetime.fromtimestamp(1e9 + second)
        files.append(Images(Path(name), count, created=date))
    clips = list_clips(files, np.arange(sum(file.count for file in files)))
    return find_gaps(clips)


ONE_A_MINUTE = [f"20260101_10{minute:02d}00.mp4" for minute in range(4)]
UNNAMED = ["a.mp4", "b.mp4", "c.mp4"]


@pytest.mark.parametrize(
    ("names", "created", "last", "expected"),
    [
        (ONE_A_MINUTE, (), 60, []),
        (ONE_A_MINUTE[:1], (), 60, []),
        ([*ONE_A_MINUTE[:2], "unknown.mp4", ONE_A_MINUTE[3]], (), 60, []),
        # The last file is shorter, and the tag is the time of the begin or of the end.
        (UNNAMED, (0, 60, 120), 20, []),
        (UNNAMED, (60, 120, 140), 20, []),
        # Whole seconds.
        (UNNAMED, (0, 62, 120), 60, []),
        # A tool that cut a video copied its tag.
        (UNNAMED, (0, 0, 0), 60, []),
        (
            [ONE_A_MINUTE[0], *ONE_A_MINUTE[2:]],
            (),
            60,
            ["by the file's name, 60 s are missing between 20260101_100000.mp4 and 20260101_1002"],
        ),
        (ONE_A_MINUTE[::2], (), 60, ["60 s are missing"]),
        (UNNAMED, (0, 63, 126), 60, ["3 s are missing between a.mp4 and b.mp4 (and 1 more)"]),
        (UNNAMED, (0, 57, 117), 60, ["by creation_time, b.mp4 begins 3 s before the end of a.mp4"]),
        (ONE_A_MINUTE[1::-1], (), 60, ["20260101_100000.mp4 begins 120 s before the end of"]),
        (ONE_A_MINUTE[::2], (0, 60), 60, ["by the file's name, 60 s"]),
        (ONE_A_MINUTE[::2], (0, 90), 60, ["by creation_time, 30 s", "by the file's name, 60 s"]),
    ],
)
def test_gaps_by_dates(names, created, last, expected):
    found = doubts(names, created, last)
    assert len(found) == len(expected)
    for doubt, words in zip(found, expected, strict=True):
        assert doubt.startswith(DOUBT)
        assert words in doubt
        assert "--times FILE" in doubt


def test_a_line_says_when_a_file_begins():
    created = datetime(2026, 1, 1, 9, 1)
    files = [Images(Path("a.mp4"), 20), Images(Path("20260101_100000.mp4"), 10, created=created)]
    lines = describe_clips(list_clips(files, np.arange(30) / 10))
    assert lines == [
        "a.mp4: 20 images, 2.0 s, taken to begin at 0.0 s",
        "20260101_100000.mp4: 10 images, 1.0 s, taken to begin at 2.0 s; creation_time says "
        "2026-01-01 09:01:00; the file's name says 2026-01-01 10:00:00",
    ]
