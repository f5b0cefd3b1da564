"""Write a video with the driven, measured and predicted path on the street, and a legend with their angles."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from pipeline.camera.images import Size, resized
from pipeline.report.path import COLOURS, STEP_M, path_steps, wheel_tracks
from pipeline.video.results import Results
from pipeline.video.source import DEFAULT_FPS, Source

# A path ends at this multiple of the distance of the nearest visible road, within limits: a narrow lens sees no nearer
# road than 11 m.
REACH, MIN_REACH_M, MAX_REACH_M = 5.0, 30.0, 100.0
MAX_WIDTH = 1280  # px
Colour = tuple[int, int, int]


def write_overlay(path: Path, source: Source, results: Results, wheelbase_m: float) -> None:
    """Write an H.264 video of the results on the complete images of `source`."""
    overlay, steps_s = _Overlay(source, results, wheelbase_m), np.diff(results.table["time_s"])
    rows = {number: row for row, number in enumerate(results.table["frame"].tolist())}
    fps = source.fps or (1 / steps_s.mean() if len(steps_s) else DEFAULT_FPS)
    with av.open(str(path), "w", format="mp4") as file:
        stream = file.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.height, stream.width = overlay.size
        stream.pix_fmt, stream.options = "yuv420p", {"preset": "veryfast"}
        for frame in source.frames():
            if frame.number in rows and frame.image is not None:
                image = overlay.draw(frame.image, rows[frame.number])
                file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode())


class _Overlay:
    """Draws results on images."""

    def __init__(self, source: Source, results: Results, wheelbase_m: float) -> None:
        self.size = _shown_size(source.camera.size)
        self._camera, self._wheelbase_m, self._results = source.camera.scaled(self.size), wheelbase_m, results
        K, horizon = self._camera.K, self._camera.horizon
        self._slope = 0.0 if horizon is None else (horizon - K[1, 2]) / K[1, 1]  # of the road, metres down per metre
        predicts = "predicted_rad" in results.table
        self._names = [*(["predicted"] if predicts else []), "measured", *(["driven"] if results.truth.name else [])]
        height, width = self.size
        steepest = (height - K[1, 2]) / K[1, 1] - self._slope  # metres down per metre ahead
        reach_m = REACH * self._camera.height_m / max(steepest, 1e-3)
        self._steps = round(min(max(reach_m, MIN_REACH_M), MAX_REACH_M) / STEP_M)
        self._thick = max(1, round(width / 480))
        self._font = max(0.3, min(0.7, width / 960, height / 300))  # 0.5: the longest text has 400 px

    def draw(self, image: np.ndarray, row: int) -> np.ndarray:
        """Return the image with the first path filled, the others as lines, and σ of the prediction as thin lines."""
        image = resized(image, self.size).copy()
        for name in self._names:
            for number, path in enumerate(self._paths(name, row)):
                thick, filled = 1 if number else self._thick, not number and name == self._names[0]
                self._draw_path(image, path, COLOURS[name], thick, filled=filled)
        self._draw_legend(image, row)
        return image

    def _paths(self, name: str, row: int) -> list[np.ndarray]:
        """Return the curvature of each step [N] of a path and of the edges of its ±σ band; none where it is unknown."""
        results, sigmas = self._results, None
        if name == "predicted" and results.path_1pm is not None:
            means, sigmas = results.path_1pm, results.path_sigma_1pm
        else:
            means = results.table[f"{name}_rad"][:, None]
            if name == "predicted" and "sigma_rad" in results.table:
                sigmas = results.table["sigma_rad"][:, None]
        mean, sigma = means[row], None if sigmas is None else sigmas[row]
        paths = [mean] if sigma is None else [mean, mean - sigma, mean + sigma]
        if not np.isfinite(mean).all():
            return []
        if means is results.path_1pm:
            return [path_steps(path, results.ahead_m, STEP_M) for path in paths]
        return [np.full(self._steps, np.tan(angle) / self._wheelbase_m) for (angle,) in paths]

    def _draw_legend(self, image: np.ndarray, row: int) -> None:
        """Write time, speed and each path's angle in its colour, on a darker box."""
        import cv2

        texts = self._legend(row)
        style = cv2.FONT_HERSHEY_SIMPLEX, self._font
        line_px, margin = round(36 * self._font), round(16 * self._font)
        width = max(cv2.getTextSize(text, *style, 1)[0][0] for text in texts)
        box = image[: line_px * len(texts) + margin, : width + 2 * margin]
        box //= 3
        for number, (text, colour) in enumerate(texts.items(), start=1):
            cv2.putText(image, text, (margin, number * line_px), *style, colour, 1, cv2.LINE_AA)

    def _legend(self, row: int) -> dict[str, Colour]:
        """Return the lines of the legend and their colours."""
        results, table = self._results, self._results.table
        speed = f"   {table['speed_mps'][row]:.1f} m/s" if table["valid"][row] else ""
        texts: dict[str, Colour] = {f"{table['time_s'][row]:.1f} s{speed}": (255, 255, 255)}
        missing = {"predicted": "waiting for a complete window", "driven": "-"}
        missing["measured"] = results.problems[row] or "low speed"
        for name in self._names:
            angle_rad, text = table[f"{name}_rad"][row], missing[name]
            if np.isfinite(angle_rad):
                spread = (
                    f" +- {np.rad2deg(table['sigma_rad'][row]):.1f}"
                    if name == "predicted" and "sigma_rad" in table
                    else ""
                )
                text = _degrees(angle_rad) + spread
            elif name == "predicted" and results.path_1pm is not None and np.isfinite(results.path_1pm[row]).all():
                turned_rad = float(path_steps(results.path_1pm[row], results.ahead_m, STEP_M).sum() * STEP_M)
                text = f"turns {_degrees(turned_rad)} in {results.ahead_m[-1]:g} m"
            texts[f"{name}: {text}"] = COLOURS[name]
        return texts

    def _draw_path(
        self, image: np.ndarray, curvature_1pm: np.ndarray, colour: Colour, thick: int, filled: bool = False
    ) -> None:
        """Draw the path of the rear wheels on a plane road, of the curvature of each step [N]."""
        import cv2

        tracks = wheel_tracks(curvature_1pm, self._camera, self._slope)
        sides = [np.rint(track).astype(np.int32) for track in tracks]
        if filled:
            shade = image.copy()
            cv2.fillPoly(shade, [np.concatenate([sides[0], sides[1][::-1]])], colour)
            cv2.addWeighted(shade, 0.45, image, 0.55, 0, dst=image)
        for side in sides:
            cv2.polylines(image, [side], False, colour, thick, cv2.LINE_AA)


def _shown_size(size: Size) -> Size:
    """Return the size of images (H, W) after reduction to MAX_WIDTH, even for 4:2:0."""
    scale = min(1.0, MAX_WIDTH / size[1])
    return max(2, int(size[0] * scale) // 2 * 2), max(2, int(size[1] * scale) // 2 * 2)


def _degrees(steering_rad: float) -> str:
    degrees = np.rad2deg(steering_rad)
    side = "left" if degrees > 0 else "right"
    return f"{abs(degrees):.1f} deg {side if abs(degrees) >= 0.05 else ''}".strip()
