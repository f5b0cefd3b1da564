"""State how motion was measured: a line of facts about drives, and a check of the unit of depth.

Both follow from the summaries of :func:`pipeline.motion.motion_file.measure_drive`, which are also
attributes of its files. No cause is named: docs/measure.md has a table that reads the line.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.summary import DOUBT, Summary

# Least share of the moving frames that are measured. Recordings by day have 1.
MIN_MEASURED = 0.9
# Largest scatter of successive speeds. Recordings have 0.02 to 0.03, the sample up to 0.05.
MAX_SCATTER = 0.08
# Largest share of the measured frames that go backwards. Where a camera looks back, angles have the
# wrong sign.
MAX_BACKWARDS = 0.5
# Least number of moving frames about which there may be a doubt.
MIN_MOVING = 10
# Least number of frames with a road in a drive that tell the unit of depth.
ROAD_FRAMES = 50


def facts_lines(summaries: Mapping[str, Summary]) -> Iterator[str]:
    """Yield a line for each drive with a doubt, and a line for all drives."""
    for drive, summary in summaries.items():
        line = facts_line(drive, [summary])
        if line.startswith(DOUBT):
            yield line
    yield facts_line("all drives", [*summaries.values()])


def facts_line(name: str, summaries: Sequence[Summary]) -> str:
    """Return how the motion of drives was measured. It begins with DOUBT if too little was.

    Counts are summed, and other values are medians over the drives.
    """
    counts = ("frames", "moving", "valid", "backwards", "road_frames")
    values = ("road_height_m", "camera_height_m", "step_s", "step_m", "scatter", "scale_sigma")
    total = {name: sum(summary[name] for summary in summaries) for name in counts}
    median = dict.fromkeys(values, 0.0)
    if summaries:
        median = {name: float(np.median([s[name] for s in summaries])) for name in values}

    height = f"known: {median['camera_height_m']:.2f} m"
    if not all(summary["scaled"] for summary in summaries):
        height = "the scale is not known"
    text = (
        f"motion of {name}: measured in {total['valid']:,} of {total['moving']:,} moving frames, "
        f"backwards in {total['backwards']:,}; a road in {total['road_frames']:,} of "
        f"{total['frames']:,} frames, by depth {median['road_height_m']:.2f} m below the camera "
        f"({height}); {median['step_s']:.2f} s and {median['step_m']:.2f} m per step; the speed "
        f"scatters by {median['scatter']:.1%} from frame to frame, and by "
        f"{median['scale_sigma']:.0%} from drive to drive"
    )
    is_doubted = (
        total["valid"] < MIN_MEASURED * total["moving"]
        or median["scatter"] > MAX_SCATTER
        or total["backwards"] > MAX_BACKWARDS * total["valid"]
    )
    return DOUBT + text if is_doubted and total["moving"] >= MIN_MOVING else text


def check_unit(summaries: Mapping[str, Summary]) -> None:
    """Raise InputError if the road is farther or nearer than it can be, so depth has another unit.

    It is judged by the road of many frames, of one drive and of all. `summaries`: drive → summary.
    Drives with a camera of unknown height, or an encoder with random weights, do not count: their
    `unit_error` is 0.
    """
    comparable = {drive: summary for drive, summary in summaries.items() if summary["unit_error"]}
    for drive, summary in comparable.items():
        _check_units([summary], drive)
    _check_units([*comparable.values()], f"{len(comparable)} drives")


def _check_units(summaries: list[Summary], where: str) -> None:
    """Raise InputError as :func:`check_unit` by the road of all frames of some drives."""
    frames = [summary["road_frames"] for summary in summaries]
    if sum(frames) < ROAD_FRAMES:
        return
    ratios = [summary["road_height_m"] / summary["camera_height_m"] for summary in summaries]
    ratio = float(np.median(np.repeat(ratios, frames)))  # each frame counts once
    factor = min(summary["unit_error"] for summary in summaries)
    if not 1 / factor < ratio < factor:
        problem = f"by depth, the road is {ratio:.2f} times the camera's height below it"
        fix = "PNG files of precomputed depth have metres × 256. Or correct the camera's height"
        raise InputError(f"{problem}: depth in other units?", where, fix)
