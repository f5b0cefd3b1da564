"""Run the stages' functions on a recording: from its images to measured motion."""

import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from pipeline.base.errors import InputError
from pipeline.camera.camera import Frame
from pipeline.camera.images import format_size
from pipeline.kitti.frames import ingest_kitti
from pipeline.kitti.ingest_file import ingest_drive
from pipeline.motion.drive import measure_drive
from pipeline.perception.drive import perceive_drive
from pipeline.settings.ingest import Reading
from pipeline.settings.perception import Perception
from pipeline.video.source import Source

INGEST, PERCEPTION, MOTION = "ingest.h5", "perception.h5", "motion.h5"
BYTES_PER_PIXEL = 6  # image 3, depth 2, class 1
MIN_SIDE = 16  # px; nothing can be recognised in smaller images


def run_chain(
    source: Source, work: Path, reading: Reading, perception: Perception, encoder: Path, *, visible: bool
) -> None:
    """Write ingest.h5, perception.h5 and motion.h5 to the folder `work`; files of an earlier run are kept.

    Args:
        source: frames are stored at ``reading.image_size``.
        work: created if it does not exist.
        reading: settings of ingest.
        perception: settings; the camera's height is that of the source.
        encoder: folder of an encoder.
        visible: show a progress bar.
    Raises:
        InputError: no frame can be read, or the disk is too small.
    """
    work.mkdir(parents=True, exist_ok=True)
    _check_images(source, reading, work)
    perception = perception.model_copy(update={"camera_height_m": source.camera.height_m})
    ingest, perceived = work / INGEST, work / PERCEPTION
    ingest_source = partial(_ingest, source=source, reading=reading)
    perceive = partial(perceive_drive, ingest=ingest, encoder=encoder, settings=perception)
    measure = partial(measure_drive, ingest=ingest, perception=perceived, road_scale=source.height_known)
    jobs: dict[str, Any] = {INGEST: ingest_source, PERCEPTION: perceive, MOTION: measure}
    with tqdm(total=source.count, unit=" frames", disable=None if visible else True) as bar:
        for name, job in jobs.items():
            bar.reset()
            bar.set_description(name.removesuffix(".h5"))
            if not (work / name).exists():
                summary = job(work / name, advance=bar.update)
                bar.total = summary["frames"]


def publish(work: Path, out: Path) -> list[Path]:
    """Move the results in ``work/new`` to `out`, remove the folder that `work` lies in, and return their paths."""
    files = [path.replace(out / path.name) for path in sorted((work / "new").iterdir())]
    shutil.rmtree(work.parent)
    return files


def _ingest(path: Path, *, source: Source, reading: Reading, advance: Any) -> dict[str, Any]:
    if source.drive:
        summary = ingest_kitti(path, drive=source.name, folder=source.drive.folder, settings=reading)
        source.notes.extend(f"{number} damaged {kind} left out" for kind, number in summary["damaged"].items())
        return summary

    def frames() -> Iterator[Frame]:
        for frame in source.frames():
            yield frame
            advance(1)

    return ingest_drive(frames(), path, drive=source.name, camera=source.camera, settings=reading)


def _check_images(source: Source, reading: Reading, work: Path) -> None:
    """Raise InputError if the images are too small, or the disk for their files is; note how they are cropped."""
    crop, size = source.camera.crop_to(reading.image_size), reading.image_size
    if min(crop.size) < MIN_SIDE:
        raise InputError(f"images are too small ({format_size(crop.size)} pixels after cropping)", source.path)
    if crop.size != source.camera.size:
        rows, columns = crop
        part = f"rows {rows.start} to {rows.stop} and columns {columns.start} to {columns.stop}"
        source.notes.append(f"images are cropped to {part}, the shape of the training images")
    needed, free = (source.count or 0) * size[0] * size[1] * BYTES_PER_PIXEL, shutil.disk_usage(work).free
    if needed > free:
        problem = f"{source.count} frames need up to {needed / 1e9:.1f} GB, but {free / 1e9:.1f} GB are free"
        raise InputError(problem, work, "Pass an --out on another disk")
