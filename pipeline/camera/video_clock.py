"""When the images of a video were taken."""

import math
from pathlib import Path

from pipeline.base.errors import DamagedFile


class VideoClock:
    """Times of a video's images since the first: its timestamps, or from image `start` on its frame rate."""

    def __init__(self, path: Path, fps: float | None, start: int | None) -> None:
        self.path, self.fps, self.start = path, fps, start
        self.last_s, self._start_s, self._first_s = -math.inf, 0.0, 0.0

    def time_s(self, index: int, position_s: float) -> float:
        """Return the time of image `index`, which the file has at `position_s`."""
        if index == 0:
            self._first_s = position_s
        since_s = position_s - self._first_s
        if self.start is None and not since_s > self.last_s:
            # The image before is the last whose timestamp is trusted; 0 and 0 at the start say that there are none.
            self.start, self._start_s = max(0, index - 1), self.last_s
        if self.start is not None:
            if self.fps is None:
                raise DamagedFile(f"{self.path} has neither timestamps nor a frame rate: say --fps")
            since_s = self._start_s + (index - self.start) / self.fps
        self.last_s = since_s
        return since_s
