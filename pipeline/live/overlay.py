"""Write a video with the driven, measured and predicted path on the street, and a legend with their angles."""

from collections.abc import Sequence
from contextlib import nullcontext, suppress
from fractions import Fraction
from pathlib import Path
from typing import Self

import av
import numpy as np

from pipeline.live.chain import FrameState
from pipeline.live.source import Source
from pipeline.report.path import COLOURS, STEP_M, path_steps, wheel_tracks

# A path ends at this multiple of the distance of the nearest visible road, within limits: a narrow lens sees no nearer
# road than 11 m.
REACH, MIN_REACH_M, MAX_REACH_M = 5.0, 30.0, 100.0
# Fragments can be played without the index that other MP4 files end with, so a killed run leaves a playable video.
CONTAINER = {"movflags": "frag_keyframe+empty_moov+default_base_moof", "flush_packets": "1"}


Colour = tuple[int, int, int]


class Overlay:
    """An H.264 video in fragmented MP4; a context manager."""

    def __init__(
        self, path: Path, source: Source, wheelbase_m: float, *, predicts: bool = True, ahead_m: Sequence[float] = ()
    ) -> None:
        """Open the video for the images of `source`.

        `predicts`: the filled path is the predicted one. `ahead_m`: edges of its ranges, for models of the path.
        """
        self._ahead_m = ahead_m
        self._camera, self._slope, self._wheelbase_m = source.camera.scaled(source.shown), source.slope, wheelbase_m
        self._names = [*(["predicted"] if predicts else []), "measured", *(["driven"] if source.truth else [])]
        height, width = source.shown
        steepest = (height - self._camera.K[1, 2]) / self._camera.K[1, 1] - self._slope  # metres down per metre ahead
        reach_m = REACH * self._camera.height_m / max(steepest, 1e-3)
        self._steps = round(min(max(reach_m, MIN_REACH_M), MAX_REACH_M) / STEP_M)
        self._thick = max(1, round(width / 480))
        self._font = max(0.3, min(0.7, width / 960, height / 300))  # 0.5: the longest text has 400 px
        self._file = av.open(str(path), "w", format="mp4", options=CONTAINER)
        self._stream = self._file.add_stream("libx264", rate=Fraction(source.fps).limit_denominator(1001))
        self._stream.width, self._stream.height, self._stream.pix_fmt = width, height, "yuv420p"
        key_interval = str(max(1, round(source.fps)))  # a fragment per second
        self._stream.options = {"preset": "veryfast", "tune": "zerolatency", "g": key_interval}

    def add(self, frame: FrameState) -> None:
        """Draw the next frame: the first path filled, the others as lines, σ of the prediction as thin lines."""
        image = frame.source_image.copy()
        measured_rad = frame.course.steering_rad if frame.course else None
        angles = {"predicted": frame.predicted_rad, "measured": measured_rad, "driven": frame.driven_rad}
        for name in self._names:
            angle_rad, colour, filled = angles[name], COLOURS[name], name == self._names[0]
            if name == "predicted" and frame.path_1pm:
                self._draw_path(image, self._steps_of(frame.path_1pm), colour, self._thick, filled=filled)
                for side in (-1, 1) if frame.path_sigma_1pm else ():  # the band where all ranges are off by σ
                    pairs = zip(frame.path_1pm, frame.path_sigma_1pm or (), strict=True)
                    self._draw_path(image, self._steps_of([mean + side * sigma for mean, sigma in pairs]), colour, 1)
            if angle_rad is None:
                continue
            self._draw_path(image, self._arc(angle_rad), colour, self._thick, filled=filled)
            if name == "predicted" and frame.sigma_rad is not None:
                for edge_rad in (angle_rad - frame.sigma_rad, angle_rad + frame.sigma_rad):
                    self._draw_path(image, self._arc(edge_rad), colour, 1)
        self._draw_legend(image, frame, angles)
        self._file.mux(self._stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))

    def _draw_legend(self, image: np.ndarray, frame: FrameState, angles: dict[str, float | None]) -> None:
        """Write time, speed and each path's angle in its colour, on a darker box."""
        import cv2

        speed = f"   {frame.course.speed_mps:.1f} m/s" if frame.course else ""
        texts = {f"{frame.time_s:.1f} s{speed}": (255, 255, 255)}
        missing = {
            "predicted": "waiting for a complete window",
            "measured": frame.problem or "low speed",
            "driven": "-",
        }
        for name in self._names:
            angle_rad = angles[name]
            spread = f" +- {np.rad2deg(frame.sigma_rad):.1f}" if name == "predicted" and frame.sigma_rad else ""
            text = missing[name] if angle_rad is None else _degrees(angle_rad) + spread
            if name == "predicted" and frame.path_1pm:
                turned_rad = float(self._steps_of(frame.path_1pm).sum() * STEP_M)
                text = f"turns {_degrees(turned_rad)} in {self._ahead_m[-1]:g} m"
            texts[f"{name}: {text}"] = COLOURS[name]
        style = cv2.FONT_HERSHEY_SIMPLEX, self._font
        (line_px, margin), widths = (round(36 * self._font), round(16 * self._font)), []
        for text in texts:
            widths.append(cv2.getTextSize(text, *style, 1)[0][0])
        box = image[: line_px * len(texts) + margin, : max(widths) + 2 * margin]
        box //= 3
        for row, (text, colour) in enumerate(texts.items(), start=1):
            cv2.putText(image, text, (margin, row * line_px), *style, colour, 1, cv2.LINE_AA)

    def _steps_of(self, path_1pm: Sequence[float]) -> np.ndarray:
        """Return the curvature of each step of a path by ranges [R]."""
        return path_steps(path_1pm, self._ahead_m, STEP_M)

    def _arc(self, steering_rad: float) -> np.ndarray:
        """Return the curvature of each step of the path at a constant steering angle [N]."""
        return np.full(self._steps, np.tan(steering_rad) / self._wheelbase_m)

    def _draw_path(
        self,
        image: np.ndarray,
        curvature_1pm: np.ndarray,
        colour: tuple[int, int, int],
        thick: int,
        filled: bool = False,
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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with nullcontext() if kind is None else suppress(av.FFmpegError):  # on a full disk, this fails again
            try:
                self._file.mux(self._stream.encode())
            finally:
                self._file.close()


def _degrees(steering_rad: float) -> str:
    degrees = np.rad2deg(steering_rad)
    side = "left" if degrees > 0 else "right"
    return f"{abs(degrees):.1f} deg {side if abs(degrees) >= 0.05 else ''}".strip()
