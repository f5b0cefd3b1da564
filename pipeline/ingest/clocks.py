"""Find gaps in the times of a drive, and compare the times of its images and packets ("oxts")."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from pipeline.base.errors import InputError
from pipeline.ingest.packets import read_stamps

# Difference in seconds between the times of a frame's image and packet, or change of the
# difference, above which a note says so. KITTI takes the nearest of 100 packets a second, so it is
# 0.01 there.
NOTED_S = 0.1
# Difference in seconds, or change of this difference, above which an image and a packet of the same
# number are not of the same frame.
LIMIT_S = 0.25
# Least time in seconds between two frames that is a gap: a car may do anything in it, so the frames
# are not consecutive. In KITTI's 55 drives, the longest step is 0.14 s. The track of
# `steer measure` continues over gaps of up to 1 s, too.
LEAST_GAP_S = 1.0
# Least ratio to the usual step that is a gap, for images that are up to 2 s apart as a rule.
LEAST_GAP_STEPS = 3.0


def is_gap(steps_s: ArrayLike, usual_s: float) -> np.ndarray:
    """Return which steps [N] between frames are gaps in time, if a step usually takes `usual_s`."""
    return np.asarray(steps_s) > max(LEAST_GAP_S, LEAST_GAP_STEPS * usual_s)


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
