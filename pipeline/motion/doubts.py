"""Doubts about a drive's measured motion, by the summary of
:func:`pipeline.motion.motion_file.measure_drive`.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.runner import Summary

# Largest share of the lowest row that may show no street. Recordings without a bonnet have 0.
MAX_STILL = 0.05
# Longest step in seconds, and in metres. At 5 images per second, half of the steps of 2 m cannot be
# measured, and the speed of the others is too low; recordings at 10 per second have steps of 1 m in
# towns.
MAX_STEP_S = 0.15
MAX_STEP_M = 2.0
# Largest roll in degrees. Upright cameras have up to 1.4, and at 10 the speed is 0.73 of the true
# one.
MAX_ROLL_DEG = 2.5
# Least share of the frames with a moving car that are measured. Recordings by day have 1.
MIN_MEASURED = 0.9
# Share that is doubted in a drive of any length: a queue of cars hides the street for a second or
# two of a short one.
FEW_MEASURED = 0.5
# Least number of frames from which shares are computed, and from which MIN_MEASURED is asked.
MIN_FRAMES = 10
LONG = 60
# Least share of the class road where depth shows a road. Recordings, grey ones too, have 0.8 and
# more.
MIN_ROAD_CLASS = 0.1
# Least share of frames with a road by depth among those with a road by classes. Recordings have 1.
MIN_ROAD_DEPTH = 0.1
# Least number of frames with a road that tell the unit of depth.
ROAD_FRAMES = 50


def find_doubts(summary: Mapping[str, float]) -> Iterator[tuple[str, str]]:
    """Yield the doubts about a drive's motion: what is in doubt, and a text for the user."""
    by_depth, by_class = summary["road_frames"], summary["road_class_frames"]
    if by_class >= MIN_FRAMES and by_depth < MIN_ROAD_DEPTH * by_class:
        share = f"depth shows a road in {by_depth:.0f} frames, classes in {by_class:.0f}"
        yield (
            "depth",
            f"{share}: inverse depth, or other units? Expected metres along the camera's axis",
        )
        return  # the others follow from it
    if summary["still"] > MAX_STILL:
        found = "a bonnet, or text, hides the lowest rows"
        yield (
            "still",
            f"{found}: depth around it is wrong, so the speed is unreliable. Crop the images "
            "above it",
        )
    yield from _step_doubts(summary)
    if abs(roll := summary["roll_deg"]) > MAX_ROLL_DEG:
        side = "clockwise" if roll > 0 else "counterclockwise"
        problem = (
            f"images are turned by {abs(roll):.0f}° {side}, by their upright edges: depth and "
            "speed are wrong"
        )
        yield (
            "roll",
            f"{problem}. Turn them back: ffmpeg -i in.mp4 -vf rotate={-roll:.0f}*PI/180 level.mp4",
        )
    if summary["road_frames"] >= MIN_FRAMES and summary["road_class"] < MIN_ROAD_CLASS:
        share = (
            f"only {summary['road_class']:.0%} of the road that is found by depth has the class "
            "road"
        )
        yield (
            "classes",
            f"{share}: classes of another numbering? Expected Cityscapes' trainIds (0 road, 10 "
            "sky)",
        )


def _step_doubts(summary: Mapping[str, float]) -> Iterator[tuple[str, str]]:
    """Yield a doubt if images are too far apart, otherwise if too many are not measured."""
    step_s, step_m = summary["step_s"], summary["step_m"]
    valid, moving = summary["valid"], summary["moving"]
    least = MIN_MEASURED if moving >= LONG else FEW_MEASURED
    if step_s > MAX_STEP_S or step_m > MAX_STEP_M:
        apart = f"{step_s:.2f} s" if step_s > MAX_STEP_S else f"{step_m:.1f} m"
        problem = (
            f"images are {apart} apart: only slow frames are measured, and their speed is too low"
        )
        yield (
            "step",
            f"{problem}. Use a recording with more images per second, 10 for a car in a town",
        )
    elif moving >= MIN_FRAMES and valid < least * moving:
        share = (
            f"only {valid:.0f} of {moving:.0f} frames with a moving car are measured, and these "
            "are unreliable"
        )
        yield (
            "measured",
            f"{share}: darkness, fog, or drops on the lens? Use a recording by day, or clean the "
            "lens",
        )


def check_unit(summaries: Mapping[str, Summary]) -> None:
    """Raise InputError if the road of many frames, of one drive or all, is farther or nearer than
    it can be.

    `summaries`: drive → summary. Drives with a camera of unknown height, or an encoder with random
    weights, do not count: their `unit_error` is 0.
    """
    known = {drive: summary for drive, summary in summaries.items() if summary["unit_error"]}
    for drives in [*([drive] for drive in known), [*known]]:
        frames = [known[drive]["road_frames"] for drive in drives]
        if sum(frames) < ROAD_FRAMES:
            continue
        ratio = float(
            np.median(np.repeat([known[drive]["height_ratio"] for drive in drives], frames))
        )
        factor = min(known[drive]["unit_error"] for drive in drives)
        if 1 / factor < ratio < factor:
            continue
        problem = (
            f"by depth, the road is {ratio:.2f} times as far below the camera as it is: depth in "
            "other units?"
        )
        fix = "PNG files of backbone: precomputed have metres × 256. Or correct the height"
        raise InputError(problem, drives[0] if len(drives) == 1 else f"{len(drives)} drives", fix)
