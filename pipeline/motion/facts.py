"""State how motion was measured: a line of facts about drives, and a check of the unit of depth.

Both follow from the summaries of :func:`pipeline.motion.measure.measure_drive`, which are also
attributes of its files. No cause is named: docs/measure.md has a table that reads the line.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

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
# Least share of the moving frames with a road. Without a road, nothing but typical speeds tells the
# speed.
MIN_ROAD = 0.5
# Smallest ratio of the camera's height by depth to its known height. Drives have 0.87 to 1.06.
MIN_HEIGHT_RATIO = 0.7
# Largest ratio of the two.
MAX_HEIGHT_RATIO = 1.4
# Time in seconds for which a speed that is doubted contradicts depth.
CONTRADICTION_S = 1.0
# Least number of moving frames about which there may be a doubt.
MIN_MOVING = 10
# Least number of moving frames that are not measured, for a doubt: a second of most recordings. A
# healthy rendered drive of 40 frames has seven.
MIN_UNMEASURED = 10
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
    """Return how the motion of drives was measured. It begins with DOUBT if that is doubtful.

    Counts are summed, and other values are medians over the drives that know them.
    """
    counts = ("moving", "valid", "backwards", "moving_road_frames")
    values = ("road_height_m", "camera_height_m", "step_s", "step_m", "scatter", "scale_sigma")
    total = {name: sum(summary[name] for summary in summaries) for name in counts}
    median = {name: _median_of_known(summary[name] for summary in summaries) for name in values}
    contradiction_s = 0.0
    if summaries:
        contradiction_s = float(np.median([summary["contradiction_s"] for summary in summaries]))

    height = f"known: {_format(median['camera_height_m'], '.2f')} m"
    height_ratio = math.nan
    if all(summary["scaled"] for summary in summaries):
        ratios = [summary["road_height_m"] / summary["camera_height_m"] for summary in summaries]
        height_ratio = _median_of_known(ratios)
    else:
        height = "the scale is not known"

    text = (
        f"motion of {name}: measured in {total['valid']:,} of {total['moving']:,} moving frames, "
        f"backwards in {total['backwards']:,}; a road in {total['moving_road_frames']:,} of them, "
        f"by depth {_format(median['road_height_m'], '.2f')} m below the camera ({height}); "
        f"{_format(median['step_s'], '.2f')} s and {_format(median['step_m'], '.2f')} m per step; "
        f"the speed scatters by {_format(median['scatter'], '.1%')} from frame to frame, and by "
        f"{_format(median['scale_sigma'], '.0%')} from drive to drive; "
        f"it contradicts depth for {contradiction_s:.1f} s"
    )
    unmeasured = total["moving"] - total["valid"]
    is_unmeasured = unmeasured >= MIN_UNMEASURED and total["valid"] < MIN_MEASURED * total["moving"]
    is_doubted = (
        is_unmeasured
        or median["scatter"] > MAX_SCATTER
        or total["backwards"] > MAX_BACKWARDS * total["valid"]
        or total["moving_road_frames"] < MIN_ROAD * total["moving"]
        or height_ratio < MIN_HEIGHT_RATIO
        or height_ratio > MAX_HEIGHT_RATIO
        or contradiction_s >= CONTRADICTION_S
    )
    return DOUBT + text if is_doubted and total["moving"] >= MIN_MOVING else text


def _median_of_known(values: Iterable[float]) -> float:
    """Return the median of the values that are not 0, which stands for unknown; else NaN."""
    known = [value for value in values if value]
    if not known:
        return math.nan
    return float(np.median(known))


def _format(value: float, form: str) -> str:
    """Return a value as text; an en dash if it is NaN."""
    return "–" if math.isnan(value) else f"{value:{form}}"


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
