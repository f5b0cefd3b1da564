"""Draw results: a picture of the track, speeds and angles, and a video with paths on the street and
a legend.
"""

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from matplotlib.figure import Figure

from pipeline.base.store import replacing, write_json
from pipeline.camera.camera import Camera
from pipeline.camera.images import resized
from pipeline.report.street_view import PATHS, STEP_M, path_steps, wheel_tracks
from steer.chain import Source
from steer.outcome import Results

MAX_WIDTH = 1280  # px, of the video
REACH_M = 60.0  # of paths at a constant angle
LINES = {"measured": "tab:blue", "predicted": "tab:green", "driven": "0.2"}


def publish(
    out: Path | None, csv: str, results: Results, source: Source, wheelbase_m: float, *, video: bool
) -> list[Path]:
    """Write the table `csv`, track.png, the quality and, if `video`, overlay.mp4 to a folder;
    return the files.
    """
    if out is None:
        return []
    with replacing(out) as new:
        new.mkdir()
        results.write_csv(new / csv)
        draw_track(new / "track.png", results)
        if results.quality:
            write_json(new / "quality.json", results.quality)
        if video:
            write_overlay(new / "overlay.mp4", source, results, wheelbase_m)
    return sorted(out.iterdir())


def draw_track(path: Path, results: Results) -> None:
    """Write a PNG of the track from above, and of speeds and angles over time."""
    table, time_s = results.table, results.table["time_s"]
    figure = Figure((10, 5), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=[1.2, 1])
    above, speed, steering = (
        figure.add_subplot(grid[place]) for place in (np.s_[:, 0], np.s_[0, 1], np.s_[1, 1])
    )
    above.set(
        title=f"{results.name}: measured track",
        xlabel="to the right, m",
        ylabel="ahead, m",
        aspect="equal",
    )
    above.set_adjustable("datalim")
    above.plot(-table["y_m"], table["x_m"], color=LINES["measured"])
    above.plot(0, 0, "o", color="tab:green")  # the start
    speed.set(ylabel="speed, m/s")
    steering.set(ylabel="steering angle, deg, left +", xlabel="time, s")
    angles = {name: np.degrees(table[f"{name}_rad"]) for name in LINES if f"{name}_rad" in table}
    speeds = {"measured": table["speed_mps"], "driven": results.truth.driven.speed_mps}
    for axes, curves in ((speed, speeds), (steering, angles)):
        for name, values in curves.items():
            axes.plot(time_s, values, ".", markersize=3, color=LINES[name], label=name)
    # above the curves
    steering.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False)
    figure.savefig(path, dpi=110, metadata={"Software": None})  # without the version of matplotlib


def write_overlay(path: Path, source: Source, results: Results, wheelbase_m: float) -> None:
    """Write an H.264 video of the results on the complete images of `source`, at most MAX_WIDTH
    wide.
    """
    scale = min(1.0, MAX_WIDTH / source.camera.size[1])
    # even for 4:2:0
    height, width = (max(2, int(side * scale) // 2 * 2) for side in source.camera.size)
    camera, paths = source.camera.scaled((height, width)), dict[str, np.ndarray]()
    for name in PATHS:  # curvature of each step of the path of each frame [N,F], NaN where unknown
        if name == "predicted" and results.path_1pm is not None:
            paths[name] = path_steps(results.path_1pm.T, results.ahead_m)
        elif np.isfinite(angle_rad := results.table.get(f"{name}_rad", np.zeros(0))).any():
            paths[name] = np.tile(np.tan(angle_rad) / wheelbase_m, (round(REACH_M / STEP_M), 1))
    rows = {number: row for row, number in enumerate(results.table["frame"].tolist())}
    time_s = results.table["time_s"]
    fps = (len(time_s) - 1) / (time_s[-1] - time_s[0]) if len(time_s) > 1 else 10.0
    with av.open(str(path), "w", format="mp4") as file:
        stream = file.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.height, stream.width, stream.pix_fmt = height, width, "yuv420p"
        stream.options = {"preset": "veryfast"}
        for frame in source.drive.frames():
            if frame.number in rows and frame.image is not None:
                image = resized(frame.image, (height, width)).copy()
                _draw(image, camera, paths, results, rows[frame.number])
                file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode())


def _draw(
    image: np.ndarray, camera: Camera, paths: dict[str, np.ndarray], results: Results, row: int
) -> None:
    """Draw the paths of a row on the road, and the legend."""
    level = camera.K[1, 2] if camera.horizon is None else camera.horizon
    slope = (level - camera.K[1, 2]) / camera.K[1, 1]  # of the road, metres down per metre ahead
    for name, path in paths.items():
        if np.isfinite(path[:, row]).all():
            sides = [
                np.rint(side).astype(np.int32) for side in wheel_tracks(path[:, row], camera, slope)
            ]
            cv2.polylines(
                image, sides, False, PATHS[name], max(1, round(camera.size[1] / 480)), cv2.LINE_AA
            )
    # 0.5: the longest text has 400 px
    size = max(0.3, min(0.7, camera.size[1] / 960, camera.size[0] / 300))
    for line, (text, colour) in enumerate(_legend(paths, results, row), start=1):
        x, y = round(16 * size), round(36 * size * line)
        # OpenCV draws thicker text wider
        outline = [(x + dx, y + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
        # readable on any ground
        for place, shade in (*((place, (0, 0, 0)) for place in outline), ((x, y), colour)):
            cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, shade, 1, cv2.LINE_AA)


def _legend(
    paths: dict[str, np.ndarray], results: Results, row: int
) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Yield lines and colours: time and speed, then the angle of each path, or how far a predicted
    path turns.
    """
    table = results.table
    speed = f"   {table['speed_mps'][row]:.1f} m/s" if table["valid"][row] else ""
    yield f"{table['time_s'][row]:.1f} s{speed}", (255, 255, 255)
    for name, path in paths.items():
        angle_deg, text = np.degrees(table[f"{name}_rad"][row]), "-"
        if np.isfinite(angle_deg):
            text = f"{angle_deg:+.1f} deg"
        elif np.isfinite(path[:, row]).all():
            text = (
                f"turns {np.degrees(path[:, row].sum() * STEP_M):+.1f} deg in "
                f"{results.ahead_m[-1]:g} m"
            )
        elif name == "measured":
            text = results.problems[row] or "low speed"
        yield f"{name}: {text}", PATHS[name]
