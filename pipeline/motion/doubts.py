"""Doubts about a drive's measured motion.

They are judged by the summary of :func:`pipeline.motion.motion_file.measure_drive`.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.runner import Summary

# Largest share of the lowest row that may show no street. Recordings without a bonnet have 0.
MAX_STILL = 0.05
# Longest step in seconds. At 5 images per second, half of the steps of 2 m cannot be measured, and
# the speed of the others is too low.
MAX_STEP_S = 0.15
# Longest step in metres. Recordings at 10 images per second have steps of 1 m in towns.
MAX_STEP_M = 2.0
# Largest roll in degrees. Upright cameras have up to 1.4, and at 10 the speed is 0.73 of the true
# one.
MAX_ROLL_DEG = 2.5
# Least share of the frames with a moving car that are measured. Recordings by day have 1.
MIN_MEASURED = 0.9
# Share that is doubted in a drive of any length: a queue of cars hides the street for a second or
# two of a short one.
FEW_MEASURED = 0.5
# Least number of frames from which shares are computed.
MIN_FRAMES = 10
# Least number of frames with a moving car from which MIN_MEASURED is asked.
LONG = 60
# Largest scatter of successive speeds. Recordings have 0.02 to 0.03, the sample up to 0.05.
MAX_SCATTER = 0.08
# Least share of the class road where depth shows a road. Recordings, grey ones too, have 0.8 and
# more.
MIN_ROAD_CLASS = 0.1
# Least share of frames with a road by depth among those with a road by classes. Recordings have 1.
MIN_ROAD_DEPTH = 0.1
# Least number of frames with a road that tell the unit of depth.
ROAD_FRAMES = 50


def find_doubts(summary: Mapping[str, float]) -> Iterator[tuple[str, str]]:
    """Yield the doubts about a drive's motion: a kind, and a text for the user."""
    by_depth = summary["road_frames"]
    by_class = summary["road_class_frames"]
    if by_class >= MIN_FRAMES and by_depth < MIN_ROAD_DEPTH * by_class:
        yield (
            "depth",
            f"depth shows a road in {by_depth:.0f} frames, classes in {by_class:.0f}: inverse "
            "depth, or other units? Expected metres along the camera's axis",
        )
        # Wrong depth is the cause of all other doubts.
        return

    if summary["still"] > MAX_STILL:
        yield (
            "still",
            "a bonnet, or text, hides the lowest rows: depth around it is wrong, so the speed is "
            "unreliable. Crop the images above it",
        )

    # Where images are too far apart or poorly tracked, few can be measured.
    if summary["step_s"] > MAX_STEP_S:
        yield _step_doubt(f"{summary['step_s']:.2f} s")
    elif summary["step_m"] > MAX_STEP_M:
        yield _step_doubt(f"{summary['step_m']:.1f} m")
    elif summary["scatter"] > MAX_SCATTER and summary["moving"] >= MIN_FRAMES:
        yield (
            "scatter",
            f"successive speeds differ by {summary['scatter']:.0%}: the images are poorly tracked "
            "or not evenly spaced in time. Use a sharper recording, or pass the images' --times",
        )
    elif _few_are_measured(summary):
        yield (
            "measured",
            f"only {summary['valid']:.0f} of {summary['moving']:.0f} frames with a moving car are "
            "measured, and these are unreliable: darkness, fog, or drops on the lens? Use a "
            "recording by day, or clean the lens",
        )

    roll_deg = summary["roll_deg"]
    if abs(roll_deg) > MAX_ROLL_DEG:
        side = "clockwise" if roll_deg > 0 else "counterclockwise"
        yield (
            "roll",
            f"images are turned by {abs(roll_deg):.0f}° {side}, by their upright edges: depth and "
            "speed are wrong. Turn them back: ffmpeg -i in.mp4 -vf "
            f"rotate={-roll_deg:.0f}*PI/180 level.mp4",
        )

    if by_depth >= MIN_FRAMES and summary["road_class"] < MIN_ROAD_CLASS:
        yield (
            "classes",
            f"only {summary['road_class']:.0%} of the road that is found by depth has the class "
            "road: classes of another numbering? Expected Cityscapes' trainIds (0 road, 10 sky)",
        )


def _step_doubt(length: str) -> tuple[str, str]:
    """Return the doubt about steps of a length, in seconds or metres."""
    return (
        "step",
        f"images are {length} apart: only slow frames are measured, and their speed is too low. "
        "Use a recording with more images per second, 10 for a car in a town",
    )


def _few_are_measured(summary: Mapping[str, float]) -> bool:
    """Return whether too few frames with a moving car are measured."""
    moving = summary["moving"]
    least = MIN_MEASURED if moving >= LONG else FEW_MEASURED
    return moving >= MIN_FRAMES and summary["valid"] < least * moving


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
    ratios = [summary["height_ratio"] for summary in summaries]
    ratio = float(np.median(np.repeat(ratios, frames)))
    factor = min(summary["unit_error"] for summary in summaries)
    if not 1 / factor < ratio < factor:
        raise InputError(
            f"by depth, the road is {ratio:.2f} times as far below the camera as it is: depth in "
            "other units?",
            where,
            "PNG files of backbone: precomputed have metres × 256. Or correct the height",
        )
