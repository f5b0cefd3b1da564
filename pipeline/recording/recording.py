"""Your own recording, and its conversion to a drive in KITTI raw's layout."""

import math
import sys
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from pipeline.base.atomic import exclusive, replacing
from pipeline.base.errors import InputError
from pipeline.base.executors import default_workers
from pipeline.camera.camera import Camera
from pipeline.camera.footage import Footage
from pipeline.kitti import steering_file
from pipeline.recording import layout
from pipeline.recording.motion_log import WheelLog
from pipeline.recording.track import ROUNDING_S, Rates, coverage


@dataclass(frozen=True)
class Recording:
    """Images, with logs of the car's motion and of its steering wheel."""

    footage: Footage
    camera: Camera  # of the images
    motion: Rates | None
    wheel: WheelLog | None
    max_gap_s: float  # longest interval between samples of a log to interpolate over

    def check_overlap(self) -> None:
        """Raise InputError if the images and a log do not overlap in time."""
        count, fps = self.footage.count, self.footage.fps
        first_s, last_s = 0.0, (count - 1) / fps if count and fps else math.inf  # a video may not announce its length
        if (times_s := self.footage.times_s) is not None:
            first_s, last_s = float(times_s[0]), float(times_s[-1])
        for name, log in (("motion", self.motion), ("wheel angles", self.wheel)):
            if log is None or log.time_s is None:
                continue
            begin_s, end_s = log.time_s[0], log.time_s[-1]
            if first_s > end_s + ROUNDING_S or last_s < begin_s - ROUNDING_S:
                raise InputError(
                    f"images from {first_s:.3f} to {last_s:.3f} s and {name} from {begin_s:.3f} to {end_s:.3f} s do "
                    "not overlap",
                    fix=f"Change --offset by {first_s - begin_s:+.3f} to align their starts",
                )

    def write(self, root: Path, drive: str, *, force: bool, visible: bool) -> dict[str, Any]:
        """Write the drive below `root`, and return counts and times; images without motion are left out.

        Args:
            force: replace an existing drive.
            visible: show a progress bar.
        Raises:
            InputError: the drive exists, no image has motion or none an angle, or the date has another camera.
        """
        folder = layout.drive_folder(root, drive, force)
        # One lock per date, as its drives share a calibration.
        with (
            exclusive(folder.parent, root / ".import" / drive[:10]),
            _removed_if_empty(folder.parent),
            replacing(folder) as unfinished,
        ):
            layout.drive_folder(root, drive, force)  # again, under the lock
            calibrated = layout.check_calibration(folder, self.camera, force)
            time_s, usable = self._write_images(unfinished, visible)
            if self.motion:
                layout.write_packets(unfinished, self.motion, time_s, usable)
            layout.write_times(unfinished, usable, time_s, (layout.IMAGES, "oxts") if self.motion else (layout.IMAGES,))
            angles = self.wheel.at(time_s, usable, self.max_gap_s) if self.wheel else {}
            if self.wheel and not angles:
                raise InputError("no image has an angle", "--wheel", "Check its times or frames, or raise --max-gap")
            if angles:
                steering_file.write(unfinished / steering_file.FILE, angles)
            if not calibrated:
                layout.write_calibration(folder, self.camera)
        summary = {
            "drive": drive,
            "folder": str(folder),
            "images": len(time_s),
            "frames": int(usable.sum()),
            "size": list(self.footage.size),
            "first_s": float(time_s[usable][0]),
            "last_s": float(time_s[usable][-1]),
            "untimed_from": self.footage.untimed_from,
            "motion": self.motion.source if self.motion else None,
            "steering_angles": len(angles),
        }
        return summary | (self._coverage(time_s)[1])

    def _write_images(self, folder: Path, visible: bool) -> tuple[np.ndarray, np.ndarray]:
        """Write the images with motion, or all without a log; return the times and the mask of written images."""
        all_s: list[float] = []
        hidden = not (visible and sys.stderr.isatty())
        frames = tqdm(self.footage.frames(), total=self.footage.count, unit=" images", disable=hidden)

        def images() -> Generator[tuple[int, np.ndarray]]:
            for number, time_s, image in frames:
                all_s.append(time_s)
                if self._coverage(np.array([time_s]))[0][0]:
                    yield number, image

        layout.write_images(folder, images(), threads=default_workers())
        time_s = np.array(all_s)
        usable, _ = self._coverage(time_s)
        if not usable.any():
            problem = f"no image lies between samples at most {self.max_gap_s:g} s apart"
            raise InputError(problem, "--motion", "Raise --max-gap")
        return time_s, usable

    def _coverage(self, time_s: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
        """Return a mask of the images at `time_s` [F] with motion (all without a log), and counts if there is a log."""
        if self.motion is None:
            return np.ones(len(time_s), bool), {}
        return coverage(self.motion.time_s, time_s, self.max_gap_s)


@contextmanager
def _removed_if_empty(folder: Path) -> Iterator[None]:
    try:
        yield
    finally:
        with suppress(OSError):
            folder.rmdir()
