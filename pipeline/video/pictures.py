"""Draw results: a picture of the track, speeds and angles, and a video with paths on the street and a legend."""

import math
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.camera.camera import Camera
from pipeline.camera.images import resized
from pipeline.report.path import COLOURS, STEP_M, follow, path_steps, wheel_tracks
from pipeline.video.results import Results
from pipeline.video.source import DEFAULT_FPS, Source

MAX_WIDTH = 1280  # px, of the video
REACH_M = 60.0  # of paths at a constant angle
LINES = {"measured": "tab:blue", "predicted": "tab:green", "driven": "0.2"}


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
        (steering, 180 / math.pi): {name: table[f"{name}_rad"] for name in LINES if f"{name}_rad" in table},
    }
    for (axes, factor), series in curves.items():
        for name, values in series.items():
            if (known := np.isfinite(values)).any():
                seconds, drawn = _separate(table["time_s"][known], values[known])
                axes.plot(seconds, factor * drawn, "--" if name == "driven" else "-", color=LINES[name], label=name)
        if len(axes.get_lines()) > 1:
            axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False)  # above the curves
    figure.savefig(path, dpi=110, metadata={"Software": None})  # without the version of matplotlib


def _draw_above(axes: Axes, results: Results) -> None:
    """Draw the measured track, and predicted paths, each the length of a path after the one before."""
    valid = results.table["valid"].astype(bool)
    x_m, y_m, heading_rad, time_s = (results.table[name][valid] for name in ("x_m", "y_m", "heading_rad", "time_s"))
    places = x_m + 1j * y_m
    _, drawn = _separate(time_s, places)
    axes.plot(-drawn.imag, drawn.real, color=LINES["measured"])
    paths_1pm, last = np.empty((len(places), 0)) if results.path_1pm is None else results.path_1pm[valid], None
    for place, heading, path_1pm in zip(places, heading_rad, paths_1pm, strict=True):
        known = len(path_1pm) and np.isfinite(path_1pm).all()
        if known and (last is None or abs(place - last) > results.ahead_m[-1]):
            ahead = place + follow(path_steps(path_1pm, results.ahead_m, STEP_M), STEP_M)[0] * np.exp(1j * heading)
            label = "predicted path" if last is None else None
            axes.plot(-ahead.imag, ahead.real, color=LINES["predicted"], label=label)
            last = place
    axes.plot(0, 0, "o", color="tab:green", label="start")
    axes.legend(loc="best")


def _separate(time_s: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times and values [N] with a NaN in each gap that is longer than a second."""
    gaps = np.flatnonzero(np.diff(time_s) > 1) + 1
    return np.insert(time_s, gaps, np.nan), np.insert(values, gaps, np.nan)


def write_overlay(path: Path, source: Source, results: Results, wheelbase_m: float) -> None:
    """Write an H.264 video of the results on the complete images of `source`, at most MAX_WIDTH wide."""
    scale, steps_s = min(1.0, MAX_WIDTH / source.camera.size[1]), np.diff(results.table["time_s"])
    height, width = (max(2, int(side * scale) // 2 * 2) for side in source.camera.size)  # even for 4:2:0
    overlay = _Overlay(source.camera.scaled((height, width)), results, wheelbase_m)
    rows = {number: row for row, number in enumerate(results.table["frame"].tolist())}
    fps = source.fps or (1 / steps_s.mean() if len(steps_s) else DEFAULT_FPS)
    with av.open(str(path), "w", format="mp4") as file:
        stream = file.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.height, stream.width, stream.pix_fmt = height, width, "yuv420p"
        stream.options = {"preset": "veryfast"}
        for frame in source.frames():
            if frame.number in rows and frame.image is not None:
                image = resized(frame.image, (height, width)).copy()
                overlay.draw(image, rows[frame.number])
                file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode())


class _Overlay:
    """Draws results on the images of a camera."""

    def __init__(self, camera: Camera, results: Results, wheelbase_m: float) -> None:
        self._camera, self._results, (height, width) = camera, results, camera.size
        level = camera.K[1, 2] if camera.horizon is None else camera.horizon
        self._slope = (level - camera.K[1, 2]) / camera.K[1, 1]  # of the road, metres down per metre ahead
        self._thick = max(1, round(width / 480))
        self._font = max(0.3, min(0.7, width / 960, height / 300))  # 0.5: the longest text has 400 px
        # Name → curvature of each step [N,F] of its path, and of the edges of its band of ±σ.
        self._paths: dict[str, list[np.ndarray]] = {}
        for name in ("predicted", "measured", "driven"):
            sigma: np.ndarray | float = results.table.get("sigma_rad", math.nan) if name == "predicted" else math.nan
            if name == "predicted" and results.path_1pm is not None:
                sigmas = math.nan if results.path_sigma_1pm is None else results.path_sigma_1pm
                means = [results.path_1pm + side * sigmas for side in (0, -1, 1)]
                means[0] = results.path_1pm
                self._paths[name] = [path_steps(mean.T, results.ahead_m, STEP_M) for mean in means]
            elif f"{name}_rad" in results.table and np.isfinite(results.table[f"{name}_rad"]).any():
                angle = results.table[f"{name}_rad"]
                curves = [np.tan(values) / wheelbase_m for values in (angle, angle - sigma, angle + sigma)]
                self._paths[name] = [np.tile(curve, (round(REACH_M / STEP_M), 1)) for curve in curves]

    def draw(self, image: np.ndarray, row: int) -> None:
        """Draw the first path filled, the others as lines, and σ of the prediction as thin lines; then the legend."""
        import cv2

        for number, (name, paths) in enumerate(self._paths.items()):
            for edge, path in enumerate(paths):
                if np.isfinite(path[:, row]).all():
                    sides = [
                        np.rint(side).astype(np.int32) for side in wheel_tracks(path[:, row], self._camera, self._slope)
                    ]
                    if number == edge == 0:
                        shade = cv2.fillPoly(image.copy(), [np.concatenate([sides[0], sides[1][::-1]])], COLOURS[name])
                        cv2.addWeighted(shade, 0.45, image, 0.55, 0, dst=image)
                    thick = 1 if edge else self._thick
                    cv2.polylines(image, sides, False, COLOURS[name], thick, cv2.LINE_AA)
        texts, style = dict(self._legend(row)), (cv2.FONT_HERSHEY_SIMPLEX, self._font)
        line_px, margin = round(36 * self._font), round(16 * self._font)
        width = max(cv2.getTextSize(text, *style, 1)[0][0] for text in texts)
        box = image[: line_px * len(texts) + margin, : width + 2 * margin]
        box //= 3
        for line, (text, colour) in enumerate(texts.items(), start=1):
            cv2.putText(image, text, (margin, line * line_px), *style, colour, 1, cv2.LINE_AA)

    def _legend(self, row: int) -> Iterator[tuple[str, tuple[int, int, int]]]:
        """Yield lines and colours: time and speed, then the angle of each path, or how far a predicted path turns."""
        results, table = self._results, self._results.table
        speed = f"   {table['speed_mps'][row]:.1f} m/s" if table["valid"][row] else ""
        yield f"{table['time_s'][row]:.1f} s{speed}", (255, 255, 255)
        for name, (path, *_) in self._paths.items():
            angle_rad, text = (
                table[f"{name}_rad"][row],
                (results.problems[row] or "low speed") if name == "measured" else "-",
            )
            if np.isfinite(angle_rad):
                text = _degrees(angle_rad)
            elif np.isfinite(path[:, row]).all():
                text = f"turns {_degrees(path[:, row].sum() * STEP_M)} in {results.ahead_m[-1]:g} m"
            yield f"{name}: {text}", COLOURS[name]


def _degrees(angle_rad: float) -> str:
    degrees = math.degrees(angle_rad)
    side = "left" if degrees > 0 else "right"
    return f"{abs(degrees):.1f} deg {side if abs(degrees) >= 0.05 else ''}".strip()
