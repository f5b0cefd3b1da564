"""Open a KITTI drive or a recording, and run the functions of the stages on its frames."""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

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
from pipeline.motion.facts import check_unit
from pipeline.motion.horizon import noted_horizon
from pipeline.motion.motion_file import measure_drive
from pipeline.perception.perceive import perceive_drive
from pipeline.perception.settings import Perception

# Names of the files that :func:`run_chain` writes.
INGEST = "ingest.h5"
PERCEPTION = "perception.h5"
MOTION = "motion.h5"
# Bytes in these files for each pixel of a frame: 3 of the image, 2 of depth and 1 of the class.
BYTES_PER_PIXEL = 6


@dataclass(frozen=True)
class Source:
    """A KITTI drive or a recording that is open, with the logs of the car."""

    path: Path
    # Name of the drive. Random draws depend on it.
    name: str
    drive: Drive
    # The camera of complete images.
    camera: Camera
    # Number of frames.
    frames: int
    logs: Logs
    # Files of the KITTI drive; None for a recording.
    files: kitti.KittiDrive | None = None
    # Doubts whether the files are one recording, in order.
    doubts: Sequence[str] = ()

    def at_height(self, height_m: float | None) -> "Source":
        """Return the source with its camera at a known height over the road.

        If `height_m` is None, the camera stays as it is.
        """
        camera = self.camera.at_height(height_m)
        drive = replace(self.drive, camera=camera)
        return replace(self, camera=camera, drive=drive)


def open_source(
    paths: Sequence[Path], reading: Reading, options: RecordingOptions, hz: float | None = None
) -> Source:
    """Open the folder of a KITTI drive, or a recording.

    If `hz` is given, only so many frames per second of a recording are kept. Raises InputError if
    the paths are neither of the two, if a calibration is missing, if files cannot be read, or if a
    log has no value at the time of the images.
    """
    source = None
    if len(paths) == 1 and paths[0].is_dir():
        files = kitti.open_folder(paths[0])
        # A folder of videos or images has none of KITTI's cameras.
        if files and any(files.images(camera) for camera in reading.cameras):
            source = _open_kitti(paths[0], files, reading, options)
    if source is None:
        source = _open_recording(paths, options, hz)
    return source.at_height(options.camera_height_m)


def _open_kitti(
    path: Path, files: kitti.KittiDrive, reading: Reading, options: RecordingOptions
) -> Source:
    lens = (options.fov_deg, options.K, options.distortion, options.fisheye)
    if any(lens) or options.fps or options.times or options.hz:
        fix = "Remove --fov, --K, --distortion, --fisheye, --fps, --times and --hz"
        raise InputError("a KITTI drive has its own calibration and times", path, fix)
    folder = files.folder.name
    if folder.endswith(kitti.UNSYNCED):
        archive = f"{folder.removesuffix(kitti.UNSYNCED)}_sync.zip"
        fix = f"Download the synced archive, {archive}"
        raise InputError("is an unsynced drive: its images are not rectified", path, fix)

    logs = read_logs(options)
    numbers, times = files.timeline(files.camera_number(reading.cameras))
    time_s = read_times(times, numbers)
    for log in logs.values():
        log.check_overlap(time_s[0], time_s[-1])

    drive = kitti.read_drive(files, reading)
    # Logs replace the values that the drive recorded itself.
    if logs:
        drive.values = logged_values(logs, np.array(numbers), time_s)
    assert drive.camera  # always true, as the drive has images
    name = folder.removesuffix("_sync")
    return Source(path, name, drive, drive.camera, len(time_s), logs, files)


def _open_recording(paths: Sequence[Path], options: RecordingOptions, hz: float | None) -> Source:
    if hz:
        options = options.model_copy(update={"hz": hz})
    recording = open_recording(paths, options)
    if not options.hz:
        recording.reduce()
    path = recording.path
    frames = len(recording.times_s)
    row = noted_horizon(path, recording.frames, recording.camera, recording.notes)
    camera = replace(recording.camera, horizon=row)
    values = logged_values(recording.logs, np.arange(frames), recording.times_s)
    drive = Drive(camera, recording.frames, values, recording.notes)
    return Source(path, path.stem, drive, camera, frames, recording.logs, doubts=recording.doubts)


@contextmanager
def run_chain(
    source: Source, out: Path | None, reading: Reading, perception: Perception, encoder: Path
) -> Iterator[Path]:
    """Yield a temporary folder with ingest.h5, perception.h5 and motion.h5.

    The folder is on the same disk as `out`, unless that is None. `encoder` is the folder of an
    encoder. Raises InputError if no frame can be read, or the disk is too small.
    """
    parent = None
    if out:
        parent = out.parent
        parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(".tmp", ".steer.", parent) as folder:
        work = Path(folder)
        _check_disk(work, source.frames, reading)
        ingest = work / INGEST
        perceived = work / PERCEPTION
        with tqdm(total=source.frames, unit=" frames", disable=None) as bar:
            bar.set_description("ingest")
            summary = write_drive(
                ingest, source.drive, source.name, "recording", reading, advance=bar.update
            )

            # Damaged frames, and frames without an image, are left out of the next file.
            bar.reset(summary["frames"])
            bar.set_description("perception")
            summary = perceive_drive(perceived, ingest, encoder, perception, advance=bar.update)

            bar.reset(summary["frames"])
            bar.set_description("motion")
            summary = measure_drive(work / MOTION, ingest, perceived, advance=bar.update)
        check_unit({source.name: summary})
        yield work


def _check_disk(work: Path, frames: int, reading: Reading) -> None:
    """Raise InputError if the frames need more than the free space of the disk."""
    height, width = reading.image_size
    needed = frames * height * width * BYTES_PER_PIXEL
    free = shutil.disk_usage(work).free
    if needed > free:
        need = f"{frames} frames need up to {needed / 1e9:.2g} GB"
        problem = f"{need}, but {free / 1e9:.2g} GB are free"
        raise InputError(problem, work, "Pass an --out on another disk")
