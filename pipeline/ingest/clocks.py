"""Compare the times of a drive's images with those of its packets ("oxts")."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.ingest.packets import read_stamps

# Difference in seconds between the times of a frame's image and packet, or change of the
# difference, above which a note says so. KITTI takes the nearest of 100 packets a second, so it is
# 0.01 there.
NOTED_S = 0.1
# Difference in seconds, or change of this difference, above which an image and a packet of the same
# number are not of the same frame.
LIMIT_S = 0.25


def compare_times(
    oxts: Path, packets: Sequence[int], times: Path, images: Sequence[int]
) -> list[str]:
    """Return a note if packets and images are more than NOTED_S apart, or drift by more.

    `oxts` and `times` are the timestamps.txt of `packets` and `images`, frame numbers in ascending
    order. Raises InputError if they are more than LIMIT_S apart, or drift by more.
    """
    after = read_stamps(oxts, packets) - read_stamps(times, images)
    after_s = (after.dropna() / pd.Timedelta(seconds=1)).to_numpy(float)
    if not len(after_s):
        return [f"times of images and packets cannot be compared ({times.parent.name})"]
    median_s = float(np.median(after_s))

    # Clocks that run apart, and images that were deleted in between, shift the end against the
    # beginning. The medians of a tenth of the frames ignore single wrong times.
    tenth = -(-len(after_s) // 10)
    drift_s = float(np.median(after_s[-tenth:]) - np.median(after_s[:tenth]))

    when = "after" if median_s > 0 else "before"
    differences = (
        f"packets are {abs(median_s):.2f} s {when} the images of the same number, and drift by "
        f"{abs(drift_s):.2f} s"
    )
    largest_s = max(abs(median_s), abs(drift_s))
    if largest_s > LIMIT_S:
        fix = (
            "Extract images and oxts of the synced archive again, and do not renumber them. If "
            f"only the times of the images are wrong, remove {times}"
        )
        raise InputError(f"{differences} (expected up to {LIMIT_S} s)", oxts, fix)
    return [differences] if largest_s > NOTED_S else []
