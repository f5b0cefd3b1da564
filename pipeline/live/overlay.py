"""The video that shows what a model says: the way that it would steer, laid on the street, and the angle in words."""

from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from pipeline import label
from pipeline.base.errors import InputError
from pipeline.camera.geometry import project
from pipeline.live.moment import Moment
from pipeline.live.view import View

PREDICTED, DRIVEN = (0, 200, 60), (230, 40, 30)  # RGB
FARTHEST_M, HALF_TRACK_M = 30.0, 0.8
MAX_WIDTH = 1280  # px; larger videos say no more
STEP_M = 0.5
TEXT_PX = 16


class Overlay:
    """A video file, MPEG-4 in MP4; a context manager. It is playable however the block ends."""

    def __init__(self, path: Path, view: View, fps: float, camera_height_m: float, wheelbase_m: float) -> None:
        """Begin a video of a camera's images; its height is over the road. Raises InputError where none can be."""
        import cv2

        scale = min(1.0, MAX_WIDTH / view.size[1])
        self._size = tuple(int(side * scale) // 2 * 2 for side in view.size)  # the format wants even sides
        self._K = view.K_at((self._size[0], self._size[1]))
        self._height_m, self._wheelbase_m = camera_height_m, wheelbase_m
        self._writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, self._size[::-1])
        if not self._writer.isOpened():
            raise InputError(
                f"{path} cannot be written as an MPEG-4 video: choose a folder for --out that can be written"
            )

    def add(self, moment: Moment) -> None:
        """Draw the next frame: the predicted way in green, the driven one, where it is known, in red."""
        import cv2

        image = cv2.resize(moment.image, self._size[::-1], interpolation=cv2.INTER_AREA)
        said = "waiting for a whole window"
        if moment.driven_rad is not None:
            self._lay(image, moment.driven_rad, DRIVEN, filled=False)
        if moment.predicted_rad is not None:
            self._lay(image, moment.predicted_rad, PREDICTED, filled=True)
            said = f"predicted {_words(moment.predicted_rad)}"
        if moment.driven_rad is not None:
            said += f"   driven {_words(moment.driven_rad)}"
        image[: 2 * TEXT_PX] = image[: 2 * TEXT_PX] // 3  # so that words are legible on any street
        text = f"{moment.time_s:6.1f} s   {said}"
        cv2.putText(image, text, (10, round(1.4 * TEXT_PX)), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255,) * 3, 1, cv2.LINE_AA)
        self._writer.write(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))

    def _lay(self, image: np.ndarray, steering_rad: float, colour: tuple[int, int, int], *, filled: bool) -> None:
        """Draw where the rear wheels would go on a flat road if the wheel stayed so."""
        import cv2

        ways = int(FARTHEST_M / STEP_M)
        ahead_left = label.path(
            np.full(ways, steering_rad), np.ones(ways), np.arange(ways) * STEP_M, wheelbase_m=self._wheelbase_m
        )
        direction = np.gradient(ahead_left, axis=0)
        to_left = np.stack([-direction[:, 1], direction[:, 0]], axis=1) / np.linalg.norm(direction, axis=1)[:, None]
        sides = []
        for side in (HALF_TRACK_M, -HALF_TRACK_M):
            ground = ahead_left + side * to_left
            xyz = np.stack([-ground[:, 1], np.full(ways, self._height_m), ground[:, 0]], axis=1)
            uv, z = project(xyz, self._K)
            sides.append(np.rint(uv[z > 1.0]).astype(np.int32))
        band = np.concatenate([sides[0], sides[1][::-1]])
        if filled:
            shade = image.copy()
            cv2.fillPoly(shade, [band], colour)
            cv2.addWeighted(shade, 0.45, image, 0.55, 0, dst=image)
        for line in sides:
            cv2.polylines(image, [line], False, colour, 2, cv2.LINE_AA)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.release()


def _words(steering_rad: float) -> str:
    degrees = np.rad2deg(steering_rad)
    side = "left" if degrees > 0 else "right"
    return f"{abs(degrees):.1f} deg {side if abs(degrees) >= 0.05 else ''}".strip()
