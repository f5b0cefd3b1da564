"""Write a video with the predicted or measured path, drawn on the street, and the numbers as text."""

from contextlib import nullcontext, suppress
from fractions import Fraction
from pathlib import Path
from typing import Self

import av
import numpy as np

from pipeline.camera.geometry import project
from pipeline.live.chain import FrameState
from pipeline.live.source import Source

PREDICTED, DRIVEN = (0, 200, 60), (230, 40, 30)  # RGB
MAX_DISTANCE_M, HALF_TRACK_M = 30.0, 0.8
MAX_WIDTH = 1280  # px
STEP_M = 0.5
TEXT_PX = 16
# Fragments can be played without the index that other MP4 files end with, so a killed run leaves a playable video.
CONTAINER = {"movflags": "frag_keyframe+empty_moov+default_base_moof", "flush_packets": "1"}


class Overlay:
    """An H.264 video in fragmented MP4; a context manager."""

    def __init__(self, path: Path, source: Source, wheelbase_m: float, *, predicts: bool = True) -> None:
        """Open the video for the images of `source`; without `predicts`, it shows the measured path."""
        scale = min(1.0, MAX_WIDTH / source.camera.size[1])
        height, width = (max(2, int(side * scale) // 2 * 2) for side in source.camera.size)  # even for 4:2:0
        self._camera, self._slope = source.camera.scaled((height, width)), source.slope
        self._wheelbase_m, self._predicts = wheelbase_m, predicts
        self._file = av.open(str(path), "w", format="mp4", options=CONTAINER)
        self._stream = self._file.add_stream("libx264", rate=Fraction(source.fps).limit_denominator(1001))
        self._stream.width, self._stream.height, self._stream.pix_fmt = width, height, "yuv420p"
        key_interval = str(max(1, round(source.fps)))  # a fragment per second
        self._stream.options = {"preset": "veryfast", "tune": "zerolatency", "g": key_interval}

    def add(self, frame: FrameState) -> None:
        """Draw the next frame: its path in green, with lines at ±σ if predicted; the driven path, if known, in red."""
        import cv2

        resized = cv2.resize(frame.source_image, self._camera.size[::-1], interpolation=cv2.INTER_AREA)
        image = np.asarray(resized, np.uint8)
        measured_rad = frame.course.steering_rad if frame.course else None
        angle_rad = frame.predicted_rad if self._predicts else measured_rad
        if frame.driven_rad is not None:
            self._draw_path(image, frame.driven_rad, DRIVEN, filled=False)
        if angle_rad is not None:
            self._draw_path(image, angle_rad, PREDICTED, filled=True)
        if self._predicts and angle_rad is not None and frame.sigma_rad is not None:
            for edge_rad in (angle_rad - frame.sigma_rad, angle_rad + frame.sigma_rad):
                self._draw_path(image, edge_rad, PREDICTED, filled=False)
        if self._predicts:
            text = "waiting for a complete window" if angle_rad is None else f"predicted {_degrees(angle_rad)}"
        else:
            text = f"{frame.course.speed_mps:.1f} m/s" if frame.course else f"not measured: {frame.problem}"
            text += "" if angle_rad is None else f"   measured {_degrees(angle_rad)}"
        if frame.driven_rad is not None:
            text += f"   driven {_degrees(frame.driven_rad)}"
        image[: 2 * TEXT_PX] = image[: 2 * TEXT_PX] // 3  # darker behind the text
        text, origin = f"{frame.time_s:6.1f} s   {text}", (10, round(1.4 * TEXT_PX))
        cv2.putText(image, text, origin, cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1, cv2.LINE_AA)
        self._file.mux(self._stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))

    def _draw_path(self, image: np.ndarray, steering_rad: float, colour: tuple[int, int, int], *, filled: bool) -> None:
        """Draw the path of the rear wheels on a plane road for a constant steering angle, an arc."""
        import cv2

        way_m = np.arange(0, MAX_DISTANCE_M, STEP_M)
        heading_rad = way_m * np.tan(steering_rad) / self._wheelbase_m
        chord_m = way_m * np.sinc(heading_rad / 2 / np.pi)
        sides = []
        for offset_m in (HALF_TRACK_M, -HALF_TRACK_M):
            ahead = chord_m * np.cos(heading_rad / 2) - offset_m * np.sin(heading_rad)
            left = chord_m * np.sin(heading_rad / 2) + offset_m * np.cos(heading_rad)
            down = self._camera.height_m + self._slope * ahead
            uv, z = project(np.stack([-left, down, ahead], axis=1), self._camera.K)
            sides.append(np.rint(uv[z > 1.0]).astype(np.int32))
        if filled:
            shade = image.copy()
            cv2.fillPoly(shade, [np.concatenate([sides[0], sides[1][::-1]])], colour)
            cv2.addWeighted(shade, 0.45, image, 0.55, 0, dst=image)
        for side in sides:
            cv2.polylines(image, [side], False, colour, 2, cv2.LINE_AA)

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
