"""Your own recording, and its conversion to a drive in KITTI raw's layout."""

import math
import shutil
import sys
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
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

GAP_S = 2.0  # left out between the parts of a split: neighbouring images are almost the same


@dataclass(frozen=True)
class Recording:
    """Images, with logs of the car's motion and of its steering wheel."""

    footage: Footage
    camera: Camera  # of the images
    motion: Rates | None
    wheel: WheelLog | None
    max_gap_s: float  # longest interval between samples of a log to interpolate over
    start_s: float = 0.0  # images before and after are left out; since the first image
    end_s: float = math.inf

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

    def write(
        self, root: Path, drives: Sequence[str], shares: Sequence[float] = (1.0,), *, force: bool, visible: bool
    ) -> dict[str, Any]:
        """Write the drives below `root`, and return counts and times; images without motion are left out.

        Args:
            drives: names, all of one date.
            shares: of the duration, one for each drive; see :func:`cut`.
            force: replace existing drives.
            visible: show a progress bar.
        Raises:
            InputError: a drive exists, no image has motion or none of a drive an angle, a part of the split is too
                short, or the date has another camera.
        """
        folders = [layout.drive_folder(root, drive, force) for drive in drives]
        date = folders[0].parent
        # One lock per date, as its drives share a calibration.
        with exclusive(date, root / ".import" / date.name), _removed_if_empty(date), ExitStack() as stack:
            for drive in drives:
                layout.drive_folder(root, drive, force)  # again, under the lock
            calibrated = layout.check_calibration(folders, self.camera, force)
            unfinished = [stack.enter_context(replacing(folder)) for folder in folders]
            time_s, usable = self._write_images(unfinished[0], visible)
            parts = cut(usable, time_s, shares)
            layout.distribute_images(unfinished, parts)
            angles = [self._write_logs(folder, time_s, part) for folder, part in zip(unfinished, parts, strict=True)]
            if not calibrated:
                layout.write_calibration(date, self.camera)
            for folder in folders:
                shutil.rmtree(folder, ignore_errors=True)  # the earlier drive, with force
        written_s = time_s[np.logical_or.reduce(parts)]
        summary = {
            "drives": {drive: int(part.sum()) for drive, part in zip(drives, parts, strict=True)},
            "folders": list(map(str, folders)),
            "images": len(time_s),
            "frames": len(written_s),
            "size": list(self.footage.size),
            "first_s": float(written_s[0]),
            "last_s": float(written_s[-1]),
            "hz": (len(time_s) - 1) / float(time_s[-1] - time_s[0]) if len(time_s) > 1 else None,
            "untimed_from": self.footage.untimed_from,
            "motion": self.motion.source if self.motion else None,
            "steering_angles": sum(angles),
        }
        return summary | (self._coverage(time_s)[1])

    def _write_logs(self, folder: Path, time_s: np.ndarray, usable: np.ndarray) -> int:
        """Write times, packets and angles of a drive's `usable` images, bool [F], taken at `time_s` [F].

        Returns the number of angles.
        """
        if self.motion:
            layout.write_packets(folder, self.motion, time_s, usable)
        layout.write_times(folder, usable, time_s, (layout.IMAGES, "oxts") if self.motion else (layout.IMAGES,))
        angles = self.wheel.at(time_s, usable, self.max_gap_s) if self.wheel else {}
        if self.wheel and not angles:
            problem = f"no image of {folder.name} has an angle"
            raise InputError(problem, "--wheel", "Check its times or frames, or raise --max-gap")
        if angles:
            steering_file.write(folder / steering_file.FILE, angles)
        return len(angles)

    def _write_images(self, folder: Path, visible: bool) -> tuple[np.ndarray, np.ndarray]:
        """Write the usable images; return the times of all images up to the end, and the mask of usable ones.

        Usable are images from start to end with motion, if there is a log of it.
        """
        all_s: list[float] = []
        hidden = not (visible and sys.stderr.isatty())
        frames = tqdm(self.footage.frames(), total=self.footage.count, unit=" images", disable=hidden)

        def images() -> Generator[tuple[int, np.ndarray]]:
            for number, time_s, image in frames:
                if all_s and time_s - all_s[0] > self.end_s - ROUNDING_S:
                    return
                all_s.append(time_s)
                if self._usable(np.array([time_s]), all_s[0])[0]:
                    yield number, image

        layout.write_images(folder, images(), threads=default_workers())
        time_s = np.array(all_s)
        usable = self._usable(time_s, all_s[0])
        if not usable.any():
            if self.start_s > time_s[-1] - time_s[0]:
                raise InputError(f"the images end after {time_s[-1] - time_s[0]:.3f} s", "--start", "Pass less")
            problem = f"no image lies between samples at most {self.max_gap_s:g} s apart"
            raise InputError(problem, "--motion", "Raise --max-gap")
        return time_s, usable

    def _usable(self, time_s: np.ndarray, first_s: float) -> np.ndarray:
        """Return a mask of the images at `time_s` [F] to write; `first_s` is the time of the first image."""
        elapsed_s = time_s - first_s
        return (
            self._coverage(time_s)[0] & (elapsed_s > self.start_s - ROUNDING_S) & (elapsed_s < self.end_s - ROUNDING_S)
        )

    def _coverage(self, time_s: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
        """Return a mask of the images at `time_s` [F] with motion (all without a log), and counts if there is a log."""
        if self.motion is None:
            return np.ones(len(time_s), bool), {}
        return coverage(self.motion.time_s, time_s, self.max_gap_s)


def cut(usable: np.ndarray, time_s: np.ndarray, shares: Sequence[float]) -> list[np.ndarray]:
    """Cut the `usable` images, bool [F], taken at `time_s` [F], into consecutive parts; return a mask of each.

    A part has its share of the duration, less the GAP_S that are left out between two parts. Raises InputError if a
    part would have fewer than two images.
    """
    first_s, last_s = time_s[usable][[0, -1]]
    edges_s = first_s + (last_s - first_s) * np.cumsum([0.0, *shares]) / sum(shares)
    ends_s = [*(edges_s[1:-1] - GAP_S), math.inf]
    parts = [usable & (time_s >= begin) & (time_s < end) for begin, end in zip(edges_s[:-1], ends_s, strict=True)]
    if short := next((share for share, part in zip(shares, parts, strict=True) if part.sum() < 2), None):
        problem = f"the part of {short:g} % has fewer than 2 images ({last_s - first_s:.1f} s in all)"
        raise InputError(
            problem, "--split", f"Pass a longer recording, or other shares: {GAP_S:g} s are left out between parts"
        )
    return parts


@contextmanager
def _removed_if_empty(folder: Path) -> Iterator[None]:
    try:
        yield
    finally:
        with suppress(OSError):
            folder.rmdir()
