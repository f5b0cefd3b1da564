"""Open a KITTI drive, a video or a folder of images, and run the stages' functions on its frames."""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from tqdm import tqdm

from pipeline.base.errors import InputError
from pipeline.base.store import replacing
from pipeline.camera.camera import Camera
from pipeline.datasets import kitti, recording
from pipeline.datasets.core.drive import Drive
from pipeline.datasets.core.ingest_file import write_drive
from pipeline.datasets.core.oxts import read_times
from pipeline.datasets.recording import Capture
from pipeline.media.log import Logs
from pipeline.motion.drive import measure_drive
from pipeline.motion.horizon import noted_horizon
from pipeline.perception.perceive import perceive_drive
from pipeline.settings.ingest import Reading
from pipeline.settings.perception import Perception

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

    @property
    def notes(self) -> list[str]:
        """Notes for the user."""
        return self.drive.notes


def open_source(
    paths: Path | Sequence[Path],
    reading: Reading,
    height_m: float | None = None,
    logs: Logs = Logs(),
    hz: float | None = None,
    capture: Capture = Capture(),
) -> Source:
    """Open a KITTI drive's folder that has images; or a folder of images, or videos.

    `height_m`: of the camera over the road; None: from a KITTI drive's calibration, else unknown. `hz`, `capture`: of
    :func:`recording.open_images`. Raises InputError if it is none of them, lacks a calibration, cannot be read, or one
    of the `logs` has no value in its time.
    """
    path, *others = [paths] if isinstance(paths, Path) else paths
    folder = kitti.KittiDrive(path.resolve()) if path.is_dir() and not others else None
    if folder and any(folder.images(camera) for camera in reading.cameras):
        if any(capture):
            fix = "Remove --fov, --K, --distortion, --fisheye, --fps and --times"
            raise InputError("a KITTI drive has its own calibration and times", path, fix)
        source = _open_drive(path, folder, reading, logs)
    else:
        source = _open_images([path, *others], capture, logs, hz)
    camera = source.camera.at_height(height_m)
    return replace(source, camera=camera, drive=replace(source.drive, camera=camera))


def _open_drive(path: Path, files: kitti.KittiDrive, reading: Reading, logs: Logs) -> Source:
    numbers, times = files.timeline(files.camera_number(reading.cameras))
    time_s = read_times(times, numbers)
    logs.check_overlap(*time_s[[0, -1]])
    drive = kitti.read_drive(files.folder, reading)
    if logs.name:
        drive = replace(drive, values=logs.values(np.array(numbers), time_s))
    assert drive.camera  # as it has images
    name = files.folder.name.removesuffix("_sync")
    return Source(path, name, drive, drive.camera, len(numbers), logs, files)


def _open_images(paths: Sequence[Path], capture: Capture, logs: Logs, hz: float | None) -> Source:
    images, camera = recording.open_images(paths, capture, logs, hz)
    camera = replace(camera, horizon=noted_horizon(images.path, images.frames, camera, images.notes))
    drive = recording.read_drive(images, camera, logs)
    return Source(images.path, images.path.stem, drive, camera, len(images.times_s), logs)


@contextmanager
def folders(out: Path | None) -> Iterator[tuple[Path, Path]]:
    """Yield a temporary folder, and one for results, which becomes the folder `out` if the block has no error."""
    with ExitStack() as stack:
        new = Path(stack.enter_context(replacing(out)) if out else stack.enter_context(TemporaryDirectory()))
        new.mkdir(exist_ok=True)
        yield Path(stack.enter_context(TemporaryDirectory(dir=new.parent))), new


def run_chain(source: Source, work: Path, reading: Reading, perception: Perception, encoder: Path) -> None:
    """Write ingest.h5, perception.h5 and motion.h5 to the folder `work`.

    `encoder`: a folder. Raises InputError if no frame can be read, or the disk is too small.
    """
    height, width = reading.image_size
    frames, free = source.frames, shutil.disk_usage(work).free
    needed = frames * height * width * BYTES_PER_PIXEL
    if needed > free:
        problem = f"{frames} frames need up to {needed / 1e9:.2g} GB, but {free / 1e9:.2g} GB are free"
        raise InputError(problem, work, "Pass an --out on another disk")
    ingest, perceived = work / INGEST, work / PERCEPTION
    jobs: dict[str, Any] = {
        INGEST: partial(write_drive, drive=source.drive, name=source.name, dataset="recording", settings=reading),
        PERCEPTION: partial(perceive_drive, ingest=ingest, encoder=encoder, settings=perception),
        MOTION: partial(measure_drive, ingest=ingest, perception=perceived),
    }
    with tqdm(total=frames, unit=" frames", disable=None) as bar:
        for name, job in jobs.items():
            bar.reset()
            bar.set_description(name.removesuffix(".h5"))
            bar.total = job(work / name, advance=bar.update)["frames"]
