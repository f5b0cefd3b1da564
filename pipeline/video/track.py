"""The measured track: a picture beside the angles and speeds, and a file of poses."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.report.path import STEP_M, follow, path_steps
from pipeline.video.results import Results

PoseFormat = Literal["kitti", "tum"]
COLOURS = {"measured": "tab:blue", "predicted": "tab:green", "driven": "0.2"}


def pose_lines(results: Results, form: PoseFormat) -> Iterator[str]:
    """Yield the lines of a file of the camera's poses in the axes of its first frame (x right, y down, z ahead).

    kitti: 3 x 4 numbers of T_first_now, row by row, for each frame; where no motion is measured, the last pose again.
    tum: seconds, position x y z and quaternion x y z w for each measured frame.
    """
    table = results.table
    valid = table["valid"].astype(bool)
    last = np.maximum.accumulate(np.where(valid, np.arange(len(valid)), -1))
    poses = np.where(last >= 0, np.stack([table["x_m"], table["y_m"], -table["heading_rad"]])[:, last], 0.0).T
    for time_s, measured, (ahead, left, turned) in zip(table["time_s"].tolist(), valid, poses.tolist(), strict=True):
        if form == "tum":  # y points down, so a left turn is negative
            numbers = [time_s, -left, 0.0, ahead, 0.0, math.sin(turned / 2), 0.0, math.cos(turned / 2)]
        else:
            cos, sin = math.cos(turned), math.sin(turned)
            numbers = [cos, 0.0, sin, -left, 0.0, 1.0, 0.0, 0.0, -sin, 0.0, cos, ahead]
        if form == "kitti" or measured:
            yield " ".join(f"{number:.9g}" for number in numbers)


def draw_track(path: Path, results: Results) -> None:
    """Write a PNG of the track from above, and of speeds and angles over time; gaps over 1 s are not connected."""
    table = results.table
    figure = Figure((10, 5), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=[1.2, 1])
    above, speed, steering = (figure.add_subplot(grid[place]) for place in (np.s_[:, 0], np.s_[0, 1], np.s_[1, 1]))
    above.set(title=f"{results.name}: measured track", xlabel="to the right, m", ylabel="ahead, m", aspect="equal")
    above.set_adjustable("datalim")
    speed.set(ylabel="speed, m/s")
    steering.set(ylabel="steering angle, deg, left +", xlabel="time, s")
    steering.axhline(0, color="0.8", zorder=0)
    if table["valid"].any():
        _draw_above(above, results)
    curves = {
        (speed, 1.0): {"measured": table["speed_mps"], "driven": results.truth.driven_mps},
        (steering, 180 / math.pi): {name: table[f"{name}_rad"] for name in COLOURS if f"{name}_rad" in table},
    }
    for (axes, factor), series in curves.items():
        for name, values in series.items():
            if (known := np.isfinite(values)).any():
                seconds, drawn = _separate(table["time_s"][known], values[known])
                axes.plot(seconds, factor * drawn, "--" if name == "driven" else "-", color=COLOURS[name], label=name)
        if len(axes.get_lines()) > 1:
            axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False)  # above the curves
    figure.savefig(path, dpi=110, metadata={"Software": None})  # without the version of matplotlib


def _draw_above(axes: Axes, results: Results) -> None:
    """Draw the measured track, and predicted paths, each the length of a path after the one before."""
    valid = results.table["valid"].astype(bool)
    x_m, y_m, heading_rad, time_s = (results.table[name][valid] for name in ("x_m", "y_m", "heading_rad", "time_s"))
    places = x_m + 1j * y_m
    _, drawn = _separate(time_s, places)
    axes.plot(-drawn.imag, drawn.real, color=COLOURS["measured"])
    paths_1pm, last = np.empty((len(places), 0)) if results.path_1pm is None else results.path_1pm[valid], None
    for place, heading, path_1pm in zip(places, heading_rad, paths_1pm, strict=True):
        known = len(path_1pm) and np.isfinite(path_1pm).all()
        if known and (last is None or abs(place - last) > results.ahead_m[-1]):
            ahead = place + follow(path_steps(path_1pm, results.ahead_m, STEP_M), STEP_M)[0] * np.exp(1j * heading)
            label = "predicted path" if last is None else None
            axes.plot(-ahead.imag, ahead.real, color=COLOURS["predicted"], label=label)
            last = place
    axes.plot(0, 0, "o", color="tab:green", label="start")
    axes.legend(loc="best")


def _separate(time_s: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times and values [N] with a NaN in each gap that is longer than a second."""
    gaps = np.flatnonzero(np.diff(time_s) > 1) + 1
    return np.insert(time_s, gaps, np.nan), np.insert(values, gaps, np.nan)
