"""Open a KITTI drive, a video or a folder of images, and run the stages' functions on its
frames.
"""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from tqdm import tqdm

from pipeline.base.errors import InputError
from pipeline.camera.camera import Camera
from pipeline.ingest.datasets import kitti
from pipeline.ingest.drive import Drive
from pipeline.ingest.ingest_file import write_drive
from pipeline.ingest.log import Logs, logged_values, read_logs
from pipeline.ingest.packets import read_times
from pipeline.ingest.recording import open_recording
from pipeline.ingest.settings import Reading, RecordingOptions
from pipeline.motion.doubts import check_unit
from pipeline.motion.horizon import noted_horizon
from pipeline.motion.motion_file import measure_drive
from pipeline.perception.perceive import perceive_drive
from pipeline.perception.settings import Perception

INGEST, PERCEPTION, MOTION = "ingest.h5", "perception.h5", "motion.h5"
BYTES_PER_PIXEL = 6  # image 3, depth 2, class 1


@dataclass(frozen=True)
class Source:
    """A drive, with the values of the car's logs."""

    path: Path
    name: str  # random draws depend on it
    drive: Drive
    camera: Camera  # of complete images
    frames: int
    logs: Logs
    files: kitti.KittiDrive | None = None  # None: a video, or a folder of images
    doubts: Sequence[str] = ()  # whether the files are one recording, in order

    def at_height(self, height_m: float | None) -> "Source":
        """Return the source with its camera at a known height over the road; None: as it is."""
        camera = self.camera.at_height(height_m)
        return replace(self, camera=camera, drive=replace(self.drive, camera=camera))


def open_source(
    paths: Sequence[Path], reading: Reading, options: RecordingOptions, hz: float | None = None
) -> Source:
    """Open a KITTI drive's folder that has images; or a recording, of which `hz` frames per second
    are kept.

    Raises InputError if it is none of them, lacks a calibration, cannot be read, or one of the logs
    has no value in its time.
    """
    path = paths[0]
    files = kitti.open_folder(path) if path.is_dir() and len(paths) == 1 else None
    if files and any(files.images(camera) for camera in reading.cameras):
        source = _open_kitti(path, files, reading, options)
    else:
        source = _open_recording(paths, options, hz)
    return source.at_height(options.camera_height_m)


def _open_kitti(
    path: Path, files: kitti.KittiDrive, reading: Reading, options: RecordingOptions
) -> Source:
    if any(
        (
            options.fov_deg,
            options.K,
            options.distortion,
            options.fisheye,
            options.fps,
            options.times,
        )
    ):
        fix = "Remove --fov, --K, --distortion, --fisheye, --fps and --times"
        raise InputError("a KITTI drive has its own calibration and times", path, fix)
    if files.folder.name.endswith(kitti.UNSYNCED):
        fix = (
            "Download the synced archive, "
            f"{files.folder.name.removesuffix(kitti.UNSYNCED)}_sync.zip"
        )
        raise InputError("is an unsynced drive: its images are not rectified", path, fix)
    logs = read_logs(options)
    numbers, times = files.timeline(files.camera_number(reading.cameras))
    time_s = read_times(times, numbers)
    for log in logs.values():
        log.check_overlap(*time_s[[0, -1]])
    drive = kitti.read_drive(files, reading)
    if logs:
        drive.values = logged_values(logs, np.array(numbers), time_s)
    assert drive.camera  # as it has images
    return Source(
        path, files.folder.name.removesuffix("_sync"), drive, drive.camera, len(time_s), logs, files
    )


def _open_recording(paths: Sequence[Path], options: RecordingOptions, hz: float | None) -> Source:
    recording = open_recording(paths, options)
    if hz:
        recording.resample(hz)
    path = recording.path
    time_s = recording.times_s
    row = noted_horizon(path, recording.frames, recording.camera, recording.notes)
    camera = replace(recording.camera, horizon=row)
    values = logged_values(recording.logs, np.arange(len(time_s)), time_s)
    drive = Drive(camera, recording.frames, values, recording.notes)
    return Source(
        path, path.stem, drive, camera, len(time_s), recording.logs, doubts=recording.doubts
    )


@contextmanager
def run_chain(
    source: Source, out: Path | None, reading: Reading, perception: Perception, encoder: Path
) -> Iterator[Path]:
    """Yield a temporary folder with ingest.h5, perception.h5 and motion.h5, on the disk of `out`,
    if there is one.

    `encoder`: a folder. Raises InputError if no frame can be read, or the disk is too small.
    """
    if out:
        out.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".steer.", suffix=".tmp", dir=out and out.parent) as folder:
        work, frames, (height, width) = Path(folder), source.frames, reading.image_size
        needed, free = frames * height * width * BYTES_PER_PIXEL, shutil.disk_usage(work).free
        if needed > free:
            problem = (
                f"{frames} frames need up to {needed / 1e9:.2g} GB, but {free / 1e9:.2g} GB are "
                "free"
            )
            raise InputError(problem, work, "Pass an --out on another disk")
        ingest, perceived = work / INGEST, work / PERCEPTION
        jobs: dict[str, Any] = {
            INGEST: partial(
                write_drive,
                drive=source.drive,
                name=source.name,
                dataset="recording",
                settings=reading,
            ),
            PERCEPTION: partial(
                perceive_drive, ingest=ingest, encoder=encoder, settings=perception
            ),
            MOTION: partial(measure_drive, ingest=ingest, perception=perceived),
        }
        with tqdm(total=frames, unit=" frames", disable=None) as bar:
            for name, job in jobs.items():
                bar.reset()
                bar.set_description(name.removesuffix(".h5"))
                summary = job(work / name, advance=bar.update)
                bar.total = summary["frames"]
        check_unit({source.name: summary})
        yield work
