"""Draw results: a figure of the track, speeds and angles, and a video with paths on the street."""

from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.base.store import replacing, write_json
from pipeline.camera.camera import Camera
from pipeline.camera.images import resized
from pipeline.report.street_view import PATHS, STEP_M, path_steps, wheel_tracks
from steer.chain import Source
from steer.outcome import Results, integrate_motion

# Largest width of the video in pixels.
MAX_WIDTH = 1280
# Length in metres of a path that is drawn for a constant steering angle.
REACH_M = 60.0
# Name of a curve → its colour in the figure.
LINES = {"measured": "tab:blue", "predicted": "tab:green", "driven": "0.2"}

# Red, green and blue, each from 0 to 255.
Colour = tuple[int, int, int]
BLACK: Colour = (0, 0, 0)


def publish(
    out: Path | None, csv: str, results: Results, source: Source, wheelbase_m: float, *, video: bool
) -> list[Path]:
    """Write the table `csv`, track.png, quality.json and, if `video`, overlay.mp4 to a folder.

    Returns the files. If `out` is None, no file is written.
    """
    if out is None:
        return []
    with replacing(out) as unfinished:
        unfinished.mkdir()
        results.write_csv(unfinished / csv)
        draw_track(unfinished / "track.png", results)
        if results.quality:
            write_json(unfinished / "quality.json", results.quality)
        if video:
            write_overlay(unfinished / "overlay.mp4", source, results, wheelbase_m)
    return sorted(out.iterdir())


def draw_track(path: Path, results: Results) -> None:
    """Write a PNG of the track from above, and of speeds and angles over time."""
    table = results.table
    figure = Figure((10, 5), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=[1.2, 1])
    above = figure.add_subplot(grid[:, 0])
    speed = figure.add_subplot(grid[0, 1])
    steering = figure.add_subplot(grid[1, 1])

    above.set(title=f"{results.name}: measured track", aspect="equal")
    above.set(xlabel="to the right, m", ylabel="ahead, m")
    above.set_adjustable("datalim")
    above.plot(-table["y_m"], table["x_m"], color=LINES["measured"], label="measured")
    recorded_m = _recorded_track(results)
    if recorded_m is not None:
        above.plot(-recorded_m.imag, recorded_m.real, color=LINES["driven"], label="recorded")
        above.set_title(f"{results.name}: {_end_error(results, recorded_m)}")
        above.legend(frameon=False)
    above.plot(0, 0, "o", color="tab:green")  # the start

    speed.set(ylabel="speed, m/s")
    steering.set(ylabel="steering angle, deg, left +", xlabel="time, s")
    speeds = {"measured": table["speed_mps"], "driven": results.truth.driven.speed_mps}
    angles = {name: np.degrees(table[f"{name}_rad"]) for name in LINES if f"{name}_rad" in table}
    for axes, curves in ((speed, speeds), (steering, angles)):
        for name, values in curves.items():
            if np.isfinite(values).any() and np.nanmax(np.abs(values)) > 0:
                axes.plot(table["time_s"], values, ".", markersize=3, color=LINES[name], label=name)

    # One standard deviation.
    speed_mps = table["speed_mps"]
    _draw_band(speed, table["time_s"], speed_mps, np.abs(speed_mps) * table["speed_sigma"])
    if "measured" in angles:
        sigma_deg = np.degrees(table["measured_sigma_rad"])
        _draw_band(steering, table["time_s"], angles["measured"], sigma_deg)
    # The legend is above the curves of the angles.
    if steering.lines:
        steering.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False)

    figure.savefig(path, dpi=110, metadata={"Software": None})  # without the version of matplotlib


def _draw_band(axes: Axes, time_s: np.ndarray, values: np.ndarray, sigma: np.ndarray) -> None:
    """Draw a band of one standard deviation around values [F]."""
    axes.fill_between(
        time_s, values - sigma, values + sigma, color=LINES["measured"], alpha=0.25, linewidth=0
    )


def _recorded_track(results: Results) -> np.ndarray | None:
    """Return the recorded places, complex numbers [F] of metres ahead + left i, if there are any.

    They begin at the first measured frame, as the measured ones do, and are NaN from the first
    frame on that the log does not cover. A log of a wheel has no speed, and so no track.
    """
    first = int(np.argmax(np.isfinite(results.table["x_m"])))
    rows = np.arange(len(results.table["x_m"]))
    driven = results.truth.driven
    speed_mps = np.where(rows < first, 0, driven.speed_mps)
    yaw_rate_radps = np.where(rows < first, 0, driven.yaw_rate_radps)
    place_m, _ = integrate_motion(results.table["time_s"], speed_mps, yaw_rate_radps)
    if not results.truth.name or not np.nan_to_num(place_m).any():
        return None
    return place_m


def _end_error(results: Results, recorded_m: np.ndarray) -> str:
    """Return how far apart the measured and the recorded track are where the first of them ends."""
    measured_m = results.table["x_m"] + 1j * results.table["y_m"]
    both = np.isfinite(measured_m) & np.isfinite(recorded_m)
    moved = np.flatnonzero(both & (recorded_m != 0))
    if not len(moved):
        return "measured track"
    last = moved[-1]
    error_m = abs(measured_m[last] - recorded_m[last])
    length_m = np.abs(np.diff(recorded_m[: last + 1])).sum()
    per_100_m = 100 * error_m / length_m
    return f"{error_m:.1f} m from the recorded track after {length_m:.0f} m ({per_100_m:.1f} %)"


def write_overlay(path: Path, source: Source, results: Results, wheelbase_m: float) -> None:
    """Write an H.264 video of the results on the complete images of `source`."""
    # Height and width are even, as H.264 stores colours at half the resolution.
    height, width = source.camera.size
    scale = min(1.0, MAX_WIDTH / width)
    size = (max(2, int(height * scale) // 2 * 2), max(2, int(width * scale) // 2 * 2))
    camera = source.camera.scaled(size)

    paths = _find_paths(results, wheelbase_m)
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
            if frame.number not in rows:
                continue
            frame.read()
            if frame.image is not None:
                row = rows[frame.number]
                image = resized(frame.image, camera.size).copy()
                _draw_paths(image, camera, paths, row)
                _draw_legend(image, _legend(paths, results, row))
                file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode())


def _find_paths(results: Results, wheelbase_m: float) -> dict[str, np.ndarray]:
    """Return the paths to draw: name → curvature [N,F] in each of N steps, NaN where unknown.

    If a path is predicted, they are this one and the one that the car took afterwards. Otherwise,
    each is that of an angle, which is held.
    """
    if results.path_1pm is not None:
        predicted = {"predicted": results.path_1pm, **results.taken_1pm}
        return {name: path_steps(path.T, results.edges_m) for name, path in predicted.items()}

    paths = {}
    steps = round(REACH_M / STEP_M)
    for name in PATHS:
        angle_rad = results.table.get(f"{name}_rad", np.zeros(0))
        if np.isfinite(angle_rad).any():
            paths[name] = np.tile(np.tan(angle_rad) / wheelbase_m, (steps, 1))
    return paths


def _draw_paths(
    image: np.ndarray, camera: Camera, paths: Mapping[str, np.ndarray], row: int
) -> None:
    """Draw the paths of a row on the road."""
    # The road falls by `slope` metres per metre ahead, in the camera's frame.
    slope = 0.0
    if camera.horizon is not None:
        slope = (camera.horizon - camera.K[1, 2]) / camera.K[1, 1]
    thickness = max(1, round(camera.size[1] / 480))
    for name, steps in paths.items():
        path = _known_part(steps[:, row])
        if len(path):
            sides = [np.rint(side).astype(np.int32) for side in wheel_tracks(path, camera, slope)]
            cv2.polylines(image, sides, False, PATHS[name], thickness, cv2.LINE_AA)


def _known_part(path: np.ndarray) -> np.ndarray:
    """Return the steps [N] of a path before the first one that is unknown."""
    unknown = np.flatnonzero(~np.isfinite(path))
    return path[: unknown[0]] if len(unknown) else path


def _draw_legend(image: np.ndarray, lines: Iterable[tuple[str, Colour]]) -> None:
    height, width, _ = image.shape
    # At size 0.5, the longest text is 400 px wide.
    size = max(0.3, min(0.7, width / 960, height / 300))
    font = cv2.FONT_HERSHEY_SIMPLEX
    x = round(16 * size)
    for number, (text, colour) in enumerate(lines, start=1):
        y = round(36 * size * number)
        # The text is drawn in black around each letter first, so that it is readable on any ground.
        # OpenCV would also draw thicker letters at a larger distance.
        places = [((x + dx, y + dy), BLACK) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
        places.append(((x, y), colour))
        for place, shade in places:
            cv2.putText(image, text, place, font, size, shade, 1, cv2.LINE_AA)


def _legend(
    paths: Mapping[str, np.ndarray], results: Results, row: int
) -> Iterator[tuple[str, Colour]]:
    """Yield lines of text and their colours: time and speed, then what each drawn path is.

    A path that a model predicts has the angle by which it turns. Any other path is that of an
    angle, which is held.
    """
    table = results.table
    text = f"{table['time_s'][row]:.1f} s"
    if table["valid"][row]:
        text += f"   {table['speed_mps'][row]:.1f} m/s"
    yield text, (255, 255, 255)

    for name, steps in paths.items():
        text = "-"
        if results.path_1pm is not None:
            title = f"{name} path"
            path = _known_part(steps[:, row])
            turn_deg = np.degrees(path.sum() * STEP_M)
            if len(path):
                text = f"turns {turn_deg:+.1f} deg in {len(path) * STEP_M:g} m"
        else:
            title = f"path of the {name} angle"
            angle_deg = np.degrees(table[f"{name}_rad"][row])
            if np.isfinite(angle_deg):
                text = f"{angle_deg:+.1f} deg"
            elif name == "measured":
                text = results.problems[row] or "low speed"
        yield f"{title}: {text}", PATHS[name]
