"""Open a drive, or convert a recording to one, and run the functions of the stages on it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from tqdm import tqdm

from pipeline.jobs.executors import default_workers

from footage.convert import USUAL_HZ, convert, open_recording
from footage.settings import Options
from pipeline.base.errors import InputError
from pipeline.base.store import write_json
from pipeline.base.summary import Summary
from pipeline.camera.camera import Camera
from pipeline.ingest.datasets import kitti
from pipeline.ingest.drive import Drive
from pipeline.ingest.settings import Reading
from pipeline.ingest.write import write_drive
from pipeline.motion.facts import check_unit
from pipeline.motion.measure import measure_drive
from pipeline.perception.perceive import perceive_drive
from pipeline.perception.settings import Perception
from steer.measurement import measurement_key, reuse_measurement

# Names of the files that :func:`run_chain` writes.
INGEST = "ingest.h5"
PERCEPTION = "perception.h5"
MOTION = "motion.h5"


@dataclass(frozen=True)
class Source:
    """A drive that is open."""

    # The path that the user passed.
    path: Path
    files: kitti.KittiDrive
    drive: Drive

    @property
    def camera(self) -> Camera:
        """The camera of complete images."""
        return self.drive.camera

    @property
    def name(self) -> str:
        """Name of the drive. Random draws depend on it."""
        return self.files.folder.name.removesuffix("_sync")

    def at_height(self, height_m: float) -> "Source":
        """Return the source with its camera at a known height over the road."""
        drive = replace(self.drive, camera=self.camera.at_height(height_m))
        return replace(self, drive=drive)


def open_source(
    paths: Sequence[Path],
    *,
    reading: Reading,
    options: Options,
    folder: Path,
    hz: float = USUAL_HZ,
) -> Source:
    """Open the folder of a drive, or convert a recording to a drive in the new `folder`.

    About `hz` images a second are taken of a recording. Raises InputError if the paths are neither
    of the two, or files cannot be used.
    """
    if len(paths) == 1 and paths[0].is_dir():
        files = kitti.open_folder(paths[0])
        # A folder of images has none of KITTI's cameras.
        if any(files.find_images(camera) for camera in reading.cameras):
            _check_drive(paths[0], files, options)
            return _open_files(paths[0], files, reading)

    recording = open_recording(paths, options)
    name = re.sub("[^A-Za-z0-9_-]+", "-", paths[0].stem)
    converted = convert(folder, name, recording, options, hz=hz)
    write_json(folder / kitti.IMPORT, converted.record, sort_keys=False)
    source = _open_files(paths[0], kitti.KittiDrive(converted.drives[0].folder), reading)
    source.drive.notes[:0] = converted.notes
    return source


def _check_drive(path: Path, files: kitti.KittiDrive, options: Options) -> None:
    """Raise InputError if options of a recording are passed with a drive, or it is unsynced."""
    if options != Options():
        passed = options.model_dump(by_alias=True, exclude_defaults=True)
        names = ", ".join(f"--{name.replace('_', '-')}" for name in passed)
        problem = "a drive has its own calibration, times and logs"
        raise InputError(problem, path, f"Remove {names}")
    folder = files.folder.name
    if folder.endswith(kitti.UNSYNCED):
        archive = f"{folder.removesuffix(kitti.UNSYNCED)}_sync.zip"
        fix = f"Download the synced archive, {archive}"
        raise InputError("is an unsynced drive: its images are not rectified", path, fix)


def _open_files(path: Path, files: kitti.KittiDrive, reading: Reading) -> Source:
    return Source(path, files, kitti.read_drive(files, reading))


class Measurement(NamedTuple):
    """What :func:`run_chain` measured."""

    # Summary of the motion, see :func:`pipeline.motion.measure.measure_drive`.
    facts: Summary
    # Cache key of depth, classes and motion.
    key: str


def run_chain(
    source: Source,
    work: Path,
    *,
    reading: Reading,
    perception: Perception,
    encoder: Path,
    earlier: Path | None = None,
) -> Measurement:
    """Write ingest.h5, perception.h5 and motion.h5 of a source to the folder `work`.

    `encoder` is the folder of an encoder. If `earlier`, an output folder of `steer measure`, has
    depth, classes and motion of the same images, code and settings, these are taken. Raises
    InputError if no frame can be read.
    """
    ingest = work / INGEST
    perceived = work / PERCEPTION
    # Further cameras of the settings are not read, and change no key.
    reading = reading.model_copy(update={"cameras": [source.files.choose_camera(reading.cameras)]})
    with tqdm(unit=" frames", disable=None) as bar:
        bar.set_description("ingest")
        summary = write_drive(ingest, source.drive, source.name, "kitti", reading, bar.update)

        key = measurement_key(ingest, perception, encoder)
        facts = reuse_measurement(earlier, work, key) if earlier else None
        if facts is not None:
            source.drive.notes.append(f"depth, classes and motion are those in {earlier}")
            return Measurement(facts, key)

        # Damaged frames, and frames without an image, are left out of the next file.
        bar.reset(summary["frames"])
        bar.set_description("perception")
        summary = perceive_drive(
            perceived,
            ingest,
            encoder,
            perception,
            max_passes=default_workers(),
            advance=bar.update,
        )
        if not summary["frames"]:
            raise InputError("no frame could be read", source.path, "; ".join(source.drive.notes))

        bar.reset(summary["frames"])
        bar.set_description("motion")
        facts = measure_drive(work / MOTION, ingest, perceived, advance=bar.update)
    check_unit({source.name: facts})
    return Measurement(facts, key)
