"""Draw results: a figure of the track, speeds and angles, and a video with paths on the street."""

from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.camera.camera import Camera
from pipeline.camera.images import resize_image
from pipeline.report.street_view import COLOURS, STEP_M, chart_colour, wheel_tracks
from steer.chain import Source
from steer.outcome import Results, integrate_motion

# Largest width of the video in pixels.
MAX_WIDTH = 1280
# Length in metres of a path that is drawn for a constant steering angle.
REACH_M = 60.0


def draw_track(path: Path, name: str, results: Results) -> None:
    """Write a PNG of the track from above, and of speeds and angles over time."""
    table = results.table
    figure = Figure((10, 5), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=[1.2, 1])
    above = figure.add_subplot(grid[:, 0])
    above.set(title=name, xlabel="to the right, m", ylabel="ahead, m", aspect="equal")
    above.set_adjustable("datalim")
    above.plot(-table["y_m"], table["x_m"], color=chart_colour("measured"))
    driven_m = driven_track(results)
    above.plot(-driven_m.imag, driven_m.real, color=chart_colour("driven"))
    above.plot(0, 0, "o", color="0.2")  # the start

    speed = figure.add_subplot(grid[0, 1], ylabel="speed, m/s")
    speeds_mps = {"measured": table["speed_mps"], "driven": results.driven.speed_mps}
    sigma_mps = np.abs(table["speed_mps"]) * table["speed_sigma"]
    _draw_curves(speed, table["time_s"], speeds_mps, sigma_mps)

    label = "steering angle, deg, left +"
    steering = figure.add_subplot(grid[1, 1], ylabel=label, xlabel="time, s")
    angles_deg = {name: np.degrees(angle) for name, angle in results.angles_rad().items()}
    _draw_curves(steering, table["time_s"], angles_deg, np.degrees(table["measured_sigma_rad"]))
    # The legend is above the curves of the angles.
    steering.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False)
    figure.savefig(path, dpi=110, metadata={"Software": None})  # without the version of matplotlib


def _draw_curves(
    axes: Axes, time_s: np.ndarray, curves: Mapping[str, np.ndarray], sigma: np.ndarray
) -> None:
    """Draw curves [F], and a band of one standard deviation around the measured one."""
    for name, values in curves.items():
        axes.plot(time_s, values, ".", markersize=3, color=chart_colour(name), label=name)
    low = curves["measured"] - sigma
    high = curves["measured"] + sigma
    axes.fill_between(time_s, low, high, color=chart_colour("measured"), alpha=0.25, linewidth=0)


def driven_track(results: Results) -> np.ndarray:
    """Return the driven places, complex numbers [F] of metres ahead + left i, NaN if unknown.

    They begin at the first measured frame, as the measured ones do, and end with the log. A log of
    a wheel has no speed, and so no track.
    """
    first = int(np.argmax(np.isfinite(results.table["x_m"])))
    moves = np.arange(len(results.table["x_m"])) >= first
    speed_mps = np.where(moves, results.driven.speed_mps, 0)
    yaw_rate_radps = np.where(moves, results.driven.yaw_rate_radps, 0)
    place_m, _ = integrate_motion(results.table["time_s"], speed_mps, yaw_rate_radps)
    return place_m


def write_overlay(path: Path, source: Source, results: Results, wheelbase_m: float) -> None:
    """Write an H.264 video of the results on the complete images of `source`."""
    # Height and width are even, as H.264 stores colours at half the resolution.
    height, width = source.camera.size
    scale = min(1.0, MAX_WIDTH / width)
    size = (max(2, int(height * scale) // 2 * 2), max(2, int(width * scale) // 2 * 2))
    camera = source.camera.scaled(size)

    paths = results.paths or _held_paths(results, wheelbase_m)
    rows = {number: row for row, number in enumerate(results.table["frame"].tolist())}
    time_s = results.table["time_s"]
    fps = 10.0
    if len(time_s) > 1:
        fps = (len(time_s) - 1) / (time_s[-1] - time_s[0])

    with av.open(str(path), "w", format="mp4") as file:
        stream = file.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.height, stream.width = camera.size
        stream.pix_fmt = "yuv420p"
        stream.options = {"preset": "veryfast"}
        for frame in source.drive.frames():
            frame.read_fields()
            if frame.number in rows and frame.image is not None:
                row = rows[frame.number]
                image = resize_image(frame.image, camera.size).copy()
                _draw_paths(image, camera, {name: path[:, row] for name, path in paths.items()})
                for number, (text, colour) in enumerate(_legend_lines(results, row)):
                    place = (10, 20 * (number + 1))
                    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1)
                file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode())


def _held_paths(results: Results, wheelbase_m: float) -> dict[str, np.ndarray]:
    """Return the path of each angle, if it is held: name → curvature [N,F] in each of N steps."""
    paths = {}
    for name, angle_rad in results.angles_rad().items():
        if np.isfinite(angle_rad).any():
            paths[name] = np.tile(np.tan(angle_rad) / wheelbase_m, (round(REACH_M / STEP_M), 1))
    return paths


def _draw_paths(image: np.ndarray, camera: Camera, paths: Mapping[str, np.ndarray]) -> None:
    """Draw paths, curvatures [N] in each step, on the road, each up to its first unknown step."""
    # The road falls by `slope` metres per metre ahead, in the camera's frame.
    slope = 0.0
    if camera.horizon is not None:
        slope = (camera.horizon - camera.K[1, 2]) / camera.K[1, 1]
    thickness = max(1, round(camera.size[1] / 480))
    for name, path in paths.items():
        known = path[np.isfinite(path).cumprod() > 0]
        if len(known):
            sides = [np.rint(side).astype(np.int32) for side in wheel_tracks(known, camera, slope)]
            cv2.polylines(image, sides, False, COLOURS[name], thickness, cv2.LINE_AA)


def _legend_lines(results: Results, row: int) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Yield lines of text and their colours: time and speed, then the angle of each path."""
    table = results.table
    speed = f"{table['speed_mps'][row]:.1f} m/s" if table["valid"][row] else results.problems[row]
    yield f"{table['time_s'][row]:.1f} s   {speed}", (255, 255, 255)
    if results.paths:
        for name in results.paths:
            yield f"{name} path", COLOURS[name]
        return
    for name, angle_rad in results.angles_rad().items():
        if np.isfinite(angle_rad[row]):
            yield f"{name}: {np.degrees(angle_rad[row]):+.1f} deg", COLOURS[name]
