"""Open a KITTI drive, a video or a folder of images, and run the stages' functions on its frames."""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.outputs import claim
from pipeline.base.store import replacing
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.images import format_size, read_image
from pipeline.kitti.ingest import IngestFile, ingest_kitti
from pipeline.kitti.oxts import read_times
from pipeline.kitti.raw import KittiDrive
from pipeline.motion.drive import measure_drive
from pipeline.perception.perceive import perceive_drive
from pipeline.settings.ingest import Reading
from pipeline.settings.perception import Perception
from pipeline.video.lens import find_horizon, fisheye, pinhole, undistortion
from pipeline.video.log import Logs
from pipeline.video.recording import open_recording

INGEST, PERCEPTION, MOTION = "ingest.h5", "perception.h5", "motion.h5"
BYTES_PER_PIXEL = 6  # image 3, depth 2, class 1


class Capture(NamedTuple):
    """Options for a recording that has no calibration of its own; None: not given."""

    fov_deg: float | None = None
    K: str | None = None
    distortion: str | None = None
    horizon: float | None = None  # row of the road's horizon; None: estimated
    fps: float | None = None
    times: Path | None = None
    fisheye: str | None = None


@dataclass(frozen=True)
class Source:
    """A camera and its frames, and the car's logs."""

    path: Path
    name: str  # random draws depend on it
    camera: Camera  # of complete images; height_m is KITTI's unless height_known
    frames: Callable[[], Iterator[Frame]]  # complete, rectified images; again with each call
    time_s: np.ndarray  # [F] of the frames; NaN in a KITTI drive
    logs: Logs
    capture: Capture
    notes: list[str] = field(default_factory=list)  # for the user
    drive: KittiDrive | None = None  # None: a video, or a folder of images
    height_known: bool = False  # of the camera over the road

    @property
    def dataset(self) -> str:
        """What the frames are of: sample, kitti or recording."""
        return self.drive.dataset if self.drive else "recording"


def open_source(
    paths: Path | Sequence[Path],
    cameras: Sequence[int],
    height_m: float | None = None,
    logs: Logs = Logs(),
    hz: float | None = None,
    capture: Capture = Capture(),
) -> Source:
    """Open a KITTI drive's folder by the first of `cameras` with images; or a folder of images, or videos.

    `height_m`: of the camera over the road; None: from a KITTI drive's calibration, else unknown. `hz`, `capture`: of
    :func:`open_images`. Raises InputError if it is none of them, lacks a calibration, cannot be read, or one of the
    `logs` has no value in its time.
    """
    path, *others = [paths] if isinstance(paths, Path) else paths
    drive = KittiDrive(path.resolve()) if path.is_dir() and not others else None
    number = next((camera for camera in cameras if drive and drive.images(camera)), None)
    if drive and number is not None:
        if any(capture):
            fix = "Remove --fov, --K, --distortion, --fisheye, --fps and --times"
            raise InputError("a KITTI drive has its own calibration and times", path, fix)
        source = _open_drive(path, drive, number, logs)
    else:
        source = open_images([path, *others], capture, logs, hz)
    if height_m is not None:
        return replace(source, camera=replace(source.camera, height_m=height_m), height_known=True)
    return source


def _open_drive(path: Path, drive: KittiDrive, number: int, logs: Logs) -> Source:
    if logs.name:
        numbers, times = drive.timeline(number)
        logs.check_overlap(*read_times(times, numbers)[[0, -1]])
    camera, images = drive.camera(number), drive.images(number)
    frames, name = partial(_read_images, images, camera), drive.folder.name.removesuffix("_sync")
    return Source(
        path, name, camera, frames, np.full(len(images), np.nan), logs, Capture(), drive=drive, height_known=True
    )


def _read_images(images: Mapping[int, Path], camera: Camera) -> Iterator[Frame]:
    for number, path in images.items():
        try:
            yield Frame(number, 0.0, read_image(path, size=camera.size))
        except DamagedFile:
            continue  # as stage ingest does with on_damaged: skip


def open_images(paths: Path | Sequence[Path], capture: Capture, logs: Logs = Logs(), hz: float | None = None) -> Source:
    """Open a recording of rectified images, `hz` of them per second, after `logs` are compared with its times."""
    recording = open_recording(paths, capture.fps, capture.times, logs.check_overlap)
    path = recording.path
    if recording.size[0] > recording.size[1]:
        sizes = f"images are taller than wide ({format_size(recording.size)} pixels): is it rotated by 90 degrees?"
        raise InputError(sizes, path, "Rotate it: ffmpeg -i in.mp4 -vf transpose=1 out.mp4 (or transpose=2)")
    if capture.distortion and capture.fisheye:
        raise InputError("expected one model of the lens, got two", fix="Pass --distortion or --fisheye")
    if capture.fisheye:
        camera, recording.straighten = fisheye(recording.size, capture.fisheye, capture.fov_deg, capture.K)
    else:
        camera = pinhole(recording.size, capture.fov_deg, capture.K)
    if capture.distortion:
        recording.straighten = undistortion(camera, capture.distortion)
    if hz:
        recording.resample(hz)
    horizon = find_horizon(recording.frames(), camera) if capture.horizon is None else capture.horizon
    found = "not found, since too few images show a drive; assuming a level camera"
    notes = [*recording.notes, f"horizon: {found if horizon is None else f'row {horizon:.0f} of {camera.size[0]}'}"]
    camera = replace(camera, horizon=horizon)
    return Source(path, path.stem, camera, recording.frames, recording.times_s, logs, capture, notes)


@contextmanager
def folders(out: Path | None, source: Source) -> Iterator[tuple[Path, Path, Path]]:
    """Yield a temporary folder, one for results, and the output folder, which gets these if the block has no error.

    `out` None: out/NAME. Raises InputError if it is not free.
    """
    folder = claim(out, source.name)
    with replacing(folder) as new, TemporaryDirectory(dir=new.parent) as work:
        new.mkdir()
        yield Path(work), new, folder


def run_chain(source: Source, work: Path, reading: Reading, perception: Perception, encoder: Path) -> None:
    """Write ingest.h5, perception.h5 and motion.h5 to the folder `work`.

    The camera's height is that of the source, not of `perception`. `encoder`: a folder. Raises InputError if no frame
    can be read, or the disk is too small.
    """
    height, width = reading.image_size
    frames, free = len(source.time_s), shutil.disk_usage(work).free
    needed = frames * height * width * BYTES_PER_PIXEL
    if needed > free:
        problem = f"{frames} frames need up to {needed / 1e9:.2g} GB, but {free / 1e9:.2g} GB are free"
        raise InputError(problem, work, "Pass an --out on another disk")
    perception = perception.model_copy(update={"camera_height_m": source.camera.height_m})
    ingest, perceived, known = work / INGEST, work / PERCEPTION, source.height_known
    jobs: dict[str, Any] = {
        INGEST: partial(_ingest, source=source, reading=reading),
        PERCEPTION: partial(perceive_drive, ingest=ingest, encoder=encoder, settings=perception),
        MOTION: partial(measure_drive, ingest=ingest, perception=perceived, road_scale=known),
    }
    with tqdm(total=frames, unit=" frames", disable=None) as bar:
        for name, job in jobs.items():
            bar.reset()
            bar.set_description(name.removesuffix(".h5"))
            bar.total = job(work / name, advance=bar.update)["frames"]


def _ingest(path: Path, *, source: Source, reading: Reading, advance: Callable[[int], object]) -> dict[str, Any]:
    if source.drive:
        summary = ingest_kitti(path, drive=source.name, folder=source.drive.folder, settings=reading)
        if summary["damaged"]:
            source.notes.append(f"{summary['damaged']} damaged files left out")
        return summary
    with IngestFile(path, source.name, source.camera, reading) as file:
        for frame in source.frames():
            file.add(frame)
            advance(1)
        return file.finish()
