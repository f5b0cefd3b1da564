"""State how motion was measured: a line of facts about drives, and a check of the unit of depth.

Both follow from the summaries of :func:`pipeline.motion.motion_file.measure_drive`, which are also
attributes of its files. No cause is named: docs/measure.md has a table that reads the line.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from pipeline.base.console import DOUBT
from pipeline.base.errors import InputError
from pipeline.base.runner import Summary

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
    frames = sum(summary["frames"] for summary in summaries)
    moving = sum(summary["moving"] for summary in summaries)
    measured = sum(summary["valid"] for summary in summaries)
    backwards = sum(summary["backwards"] for summary in summaries)
    road_frames = sum(summary["road_frames"] for summary in summaries)
    scatter = _median(summaries, "scatter")

    height = f"known: {_median(summaries, 'camera_height_m'):.2f} m"
    if not all(summary["scaled"] for summary in summaries):
        height = "the scale is not known"
    text = (
        f"motion of {name}: measured in {measured:,} of {moving:,} moving frames, backwards in "
        f"{backwards:,}; a road in {road_frames:,} of {frames:,} frames, by depth "
        f"{_median(summaries, 'road_height_m'):.2f} m below the camera ({height}); "
        f"{_median(summaries, 'step_s'):.2f} s and {_median(summaries, 'step_m'):.2f} m per step; "
        f"the speed scatters by {scatter:.1%} from frame to frame, and by "
        f"{_median(summaries, 'scale_sigma'):.0%} from drive to drive"
    )
    is_doubted = (
        measured < MIN_MEASURED * moving
        or scatter > MAX_SCATTER
        or backwards > MAX_BACKWARDS * measured
    )
    return DOUBT + text if is_doubted and moving >= MIN_MOVING else text


def _median(summaries: Sequence[Summary], name: str) -> float:
    """Return the median of a value of summaries; 0 if there are none."""
    values = [summary[name] for summary in summaries]
    return float(np.median(values)) if values else 0.0


def check_unit(summaries: Mapping[str, Summary]) -> None:
    """Raise InputError if the road is farther or nearer than it can be, so depth has another unit.

    `summaries` maps drives to their summaries. Drives with few frames with a road, a camera of
    unknown height, or an encoder with random weights do not count.
    """
    for drive, summary in summaries.items():
        ratio = summary["road_height_m"] / summary["camera_height_m"]
        factor = summary["unit_error"]
        if not factor or summary["road_frames"] < ROAD_FRAMES:
            continue
        if not 1 / factor < ratio < factor:
            problem = f"by depth, the road is {ratio:.2f} times as far below the camera as it is"
            fix = "PNG files of backbone: precomputed have metres × 256. Or correct the height"
            raise InputError(f"{problem}: depth in other units?", drive, fix)
