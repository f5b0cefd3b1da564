"""Draw the measured track from above, and speed and steering angle over time."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pipeline.live.frame_state import Course
from pipeline.report import drawing


def draw(path: Path, title: str, courses: Sequence[tuple[float, Course]]) -> None:
    """Write a PNG of the times and courses of measured frames. Gaps longer than a second are not connected."""
    figure = Figure((10, 5), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=[1.2, 1])
    above, speed, steering = (figure.add_subplot(grid[place]) for place in (np.s_[:, 0], np.s_[0, 1], np.s_[1, 1]))
    above.set(title=f"{title}: measured track", xlabel="to the right, m", ylabel="ahead, m", aspect="equal")
    above.set_adjustable("datalim")
    speed.set(ylabel="speed, m/s")
    steering.set(ylabel="steering angle, deg, left +", xlabel="time, s")
    if courses:
        time_s = [seconds for seconds, _ in courses]
        columns = np.array([course for _, course in courses], np.float64)  # None becomes NaN
        gaps = np.flatnonzero(np.diff(time_s) > 1) + 1
        seconds, columns = np.insert(time_s, gaps, np.nan), np.insert(columns, gaps, np.nan, axis=0)
        above.plot(-columns[:, 5], columns[:, 4], color="0.2")
        above.plot(0, 0, "o", color="tab:green", label="start")
        above.legend(loc="best")
        speed.plot(seconds, columns[:, 0], color="tab:blue")
        steering.plot(seconds, np.rad2deg(columns[:, 3]), color="tab:red")
        steering.axhline(0, color="0.8", zorder=0)
    drawing.save(figure, path)
