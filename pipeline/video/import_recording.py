"""Convert a recording with its logs to drives in KITTI raw's layout."""

import math
import shutil
import sys
from collections.abc import Generator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.base.executors import default_workers
from pipeline.camera.camera import Camera
from pipeline.kitti.oxts import STEERING, write_steering
from pipeline.video import drive_layout as layout
from pipeline.video.log import ROUNDING_S, MotionLog, WheelLog
from pipeline.video.recording import Recording

GAP_S = 2.0  # left out between the parts of a split: neighbouring images are almost the same


@dataclass(frozen=True)
class Import:
    """A recording, with logs of the car's motion and of its steering wheel."""

    recording: Recording
    camera: Camera
    motion: MotionLog | None
    wheel: WheelLog | None
    max_gap_s: float  # longest interval between samples of a log to interpolate over
    start_s: float = 0.0  # images before and after are left out; since the first image
    end_s: float = math.inf

    def check_overlap(self) -> None:
        """Raise InputError if the images and a log do not overlap in time."""
        count, fps, times_s = self.recording.count, self.recording.fps, self.recording.times_s
        first_s, last_s = 0.0, (count - 1) / fps if count and fps else math.inf  # a video may not announce its length
        if times_s is not None:
            first_s, last_s = float(times_s[0]), float(times_s[-1])
        for name, log in (("motion", self.motion), ("wheel angles", self.wheel)):
            if log is None or log.time_s is None:
                continue
            begin_s, end_s = log.time_s[0], log.time_s[-1]
            if first_s > end_s + ROUNDING_S or last_s < begin_s - ROUNDING_S:
                spans = f"images from {first_s:.3f} to {last_s:.3f} s, {name} from {begin_s:.3f} to {end_s:.3f} s"
                fix = f"Change --offset by {first_s - begin_s:+.3f} to align their starts"
                raise InputError(f"{spans} do not overlap", fix=fix)

    def write(self, root: Path, drive: str, shares: Sequence[float], *, replace: bool, visible: bool) -> dict[str, Any]:
        """Write drives below `root`, and return counts and times; images without motion are left out.

        Args:
            drive: name of the first; the others have the following numbers.
            shares: of the duration, one for each drive; see :func:`cut`.
            replace: replace drives of an earlier import.
            visible: show a progress bar.

        Raises InputError if a drive exists, no image has motion or none of a drive an angle, a part of the split is too
        short, or the date has another camera.
        """
        drives = layout.drive_folders(root, drive, len(shares), replace)
        folders, date = list(drives.values()), root / drive[:10]
        calibrated = layout.check_calibration(folders, self.camera, replace)
        with ExitStack() as stack:
            unfinished = [stack.enter_context(replacing(folder)) for folder in folders]
            time_s, usable = self._write_images(unfinished[0], visible)
            parts = cut(usable, time_s, shares)
            layout.distribute_images(unfinished, parts)
            angles = [self._write_logs(folder, time_s, part) for folder, part in zip(unfinished, parts, strict=True)]
            if not calibrated:
                layout.write_calibration(date, self.camera)
            for folder in unfinished:
                layout.write_horizon(folder, self.camera.horizon)
            manifests = [layout.write_manifest(folder, date) for folder in unfinished]
            for folder in folders:
                shutil.rmtree(folder, ignore_errors=True)  # the earlier import
        written_s = time_s[np.logical_or.reduce(parts)]
        return {
            "drives": {drive: int(part.sum()) for drive, part in zip(drives, parts, strict=True)},
            "folders": list(map(str, folders)),
            "manifests": dict(zip(drives, manifests, strict=True)),
            "images": len(time_s),
            "frames": len(written_s),
            "size": list(self.recording.size),
            "horizon": self.camera.horizon,
            "first_s": float(written_s[0]),
            "last_s": float(written_s[-1]),
            "hz": (len(time_s) - 1) / float(time_s[-1] - time_s[0]) if len(time_s) > 1 else None,
            "steering_angles": sum(angles),
        }

    def _write_logs(self, folder: Path, time_s: np.ndarray, usable: np.ndarray) -> int:
        """Write times, packets and angles of a drive's `usable` images, bool [F], taken at `time_s` [F].

        Returns the number of angles.
        """
        if self.motion:
            layout.write_packets(folder, self.motion, time_s, usable)
        sensors = (layout.IMAGES, "oxts") if self.motion else (layout.IMAGES,)
        layout.write_times(folder, folder.name[:10], time_s, sensors)
        if self.wheel is None:
            return 0
        steering_rad = self.wheel.at(np.arange(len(time_s)), time_s, self.max_gap_s)
        known = np.flatnonzero(usable & np.isfinite(steering_rad)).tolist()
        if not known:
            problem = f"no image of {folder.name} has an angle"
            raise InputError(problem, "--wheel", "Check its times or frames, or raise --max-gap")
        write_steering(folder / STEERING, {number: float(steering_rad[number]) for number in known})
        return len(known)

    def _write_images(self, folder: Path, visible: bool) -> tuple[np.ndarray, np.ndarray]:
        """Write the usable images; return the times of all images up to the end, and the mask of usable ones.

        Usable are images from start to end with motion, if there is a log of it.
        """
        all_s: list[float] = []
        hidden = not (visible and sys.stderr.isatty())
        frames = tqdm(self.recording.frames(), total=self.recording.count, unit=" images", disable=hidden)

        def images() -> Generator[tuple[int, np.ndarray]]:
            for frame in frames:
                if all_s and frame.time_s - all_s[0] > self.end_s - ROUNDING_S:
                    return
                all_s.append(frame.time_s)
                assert frame.image is not None
                if self._usable(np.array([frame.time_s]), all_s[0])[0]:
                    yield frame.number, frame.image
            if self.wheel:
                self.wheel.check_frames(len(all_s) - 1)

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
        inside = (elapsed_s > self.start_s - ROUNDING_S) & (elapsed_s < self.end_s - ROUNDING_S)
        return inside & np.isfinite(self.motion.at(time_s, self.max_gap_s)[0]) if self.motion else inside


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
        fix = f"Pass a longer recording, or other shares: {GAP_S:g} s are left out between parts"
        raise InputError(problem, "--split", fix)
    return parts
