"""The measured track: a picture beside the angles and speeds, and a file of poses."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from pipeline.live.results import Results
from pipeline.report.path import STEP_M, follow, path_steps

PoseFormat = Literal["kitti", "tum"]
COLOURS = {"measured": "tab:blue", "predicted": "tab:green", "driven": "0.2"}


def pose_lines(results: Results, form: PoseFormat) -> Iterator[str]:
    """Yield the lines of a file of the camera's poses in the axes of its first frame (x right, y down, z ahead).

    kitti: 3 x 4 numbers of T_first_now, row by row, for each frame; where no motion is measured, the last pose again.
    tum: seconds, position x y z and quaternion x y z w for each measured frame.
    """
    courses, pose = dict(results.courses), (0.0, 0.0, 0.0)
    for time_s in results.columns("time_s")[0].tolist():
        if course := courses.get(time_s):
            pose = course.x_m, course.y_m, -course.heading_rad  # y points down, so a left turn is negative
        elif form == "tum":
            continue
        ahead_m, left_m, turned_rad = pose
        if form == "tum":
            numbers: tuple[float, ...] = (
                time_s,
                -left_m,
                0.0,
                ahead_m,
                0.0,
                math.sin(turned_rad / 2),
                0.0,
                math.cos(turned_rad / 2),
            )
        else:
            cos, sin = math.cos(turned_rad), math.sin(turned_rad)
            numbers = cos, 0.0, sin, -left_m, 0.0, 1.0, 0.0, 0.0, -sin, 0.0, cos, ahead_m
        yield " ".join(f"{number:.9g}" for number in numbers)


def draw_track(path: Path, title: str, results: Results) -> None:
    """Write a PNG of the track from above, and of speeds and angles over time; gaps over 1 s are not connected."""
    figure = Figure((10, 5), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=[1.2, 1])
    above, speed, steering = (figure.add_subplot(grid[place]) for place in (np.s_[:, 0], np.s_[0, 1], np.s_[1, 1]))
    above.set(title=f"{title}: measured track", xlabel="to the right, m", ylabel="ahead, m", aspect="equal")
    above.set_adjustable("datalim")
    speed.set(ylabel="speed, m/s")
    steering.set(ylabel="steering angle, deg, left +", xlabel="time, s")
    steering.axhline(0, color="0.8", zorder=0)
    if results.courses:
        seconds = np.array([seconds for seconds, _ in results.courses])
        ahead_left = np.array([(course.x_m, course.y_m) for _, course in results.courses])
        _, (ahead_m, left_m) = _separate(seconds, ahead_left.T)
        above.plot(-left_m, ahead_m, color=COLOURS["measured"])
        for index, (course, path_1pm) in enumerate(results.paths):
            places, _ = follow(path_steps(path_1pm, results.ahead_m, STEP_M), STEP_M)
            places = complex(course.x_m, course.y_m) + places * np.exp(1j * course.heading_rad)
            label = "predicted path" if index == 0 else None
            above.plot(-places.imag, places.real, color=COLOURS["predicted"], label=label)
        above.plot(0, 0, "o", color="tab:green", label="start")
        above.legend(loc="best")
    for axes, unit, factor in ((speed, "mps", 1.0), (steering, "rad", 180 / math.pi)):
        for name, colour in COLOURS.items():
            time_s, values = results.columns("time_s", f"{name}_{unit}")
            if (known := np.isfinite(values)).any():
                seconds, (values,) = _separate(time_s[known], values[None, known])
                axes.plot(seconds, factor * values, "--" if name == "driven" else "-", color=colour, label=name)
        if len(axes.get_lines()) > 1:
            axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False)  # above the curves
    figure.savefig(path, dpi=110, metadata={"Software": None})  # without the version of matplotlib


def _separate(time_s: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times [N] and values [C,N] with a NaN in each gap that is longer than a second."""
    gaps = np.flatnonzero(np.diff(time_s) > 1) + 1
    return np.insert(time_s, gaps, np.nan), np.insert(values, gaps, np.nan, axis=1)
