"""Read raw drives once and write one HDF5 file per drive, with everything that later stages need."""

from functools import partial
from pathlib import Path

import numpy as np

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.base.params import load
from pipeline.base.runner import Job, Summary, run_over_drives
from pipeline.camera.camera import write_camera
from pipeline.kitti import oxts
from pipeline.kitti.ingest_file import (
    PIXELS,
    TolerantReader,
    put_motion,
    put_pixels,
    put_scans,
    put_steering,
)
from pipeline.kitti.raw import RawDrive, find_drives, read_scan
from pipeline.labels import steering_file
from pipeline.sections.ingest import Ingest

_FIXES = {
    "town": "Make it: dvc repro town",
    "kitti": "Link it: ln -s /path/to/kitti {root}. Only training? dvc pull labels graphs",
}


def main(
    town: Path = Path("data/town"),
    raw: Path = Path("data/raw"),
    out: Path = Path("data/ingest"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Read oxts, steering angles, images, LiDAR scans, calibration and dense ground truth of raw drives.

    Returns the stage's folder.
    """
    settings = load(Ingest, params)
    splits, sources = settings.drives.splits(), settings.sources()
    drives: dict[str, RawDrive] = {}
    for source, root in {"town": town, "kitti": raw}.items():
        names = [drive for drive in splits if sources[drive] == source]
        if names and not root.is_dir():
            raise InputError("folder is missing", root, _FIXES[source].format(root=root))
        drives |= find_drives(root, names) if names else {}
    if settings.source == "both":
        _check_names([drive for drive in splits if sources[drive] == "town"], raw)
    frames = {
        drive: len(files.oxts) or max(len(files.images(number)) for number in settings.cameras)
        for drive, files in drives.items()
    }
    jobs = []
    for drive in sorted(splits, key=frames.__getitem__, reverse=True):
        files = drives[drive]
        fingerprint = files.fingerprint(settings.cameras)
        attributes = {"split": splits[drive], "source": sources[drive], "fingerprint": fingerprint}
        jobs.append(
            Job(
                drive,
                out / f"{drive}.h5",
                [*attributes.values(), files.changes(settings.cameras)],
                partial(_ingest, drive=drive, folder=files.folder, attributes=attributes, settings=settings),
            )
        )
    with run_over_drives(
        "ingest", settings.model_dump(mode="json", exclude={"drives"}), jobs, out, _describe, workers=workers
    ) as summaries:
        store.write_index(out, splits)
    for name, plural in (("image", "images"), ("lidar", "scans"), ("oxts", "oxts")):
        lacking = [drive for drive in splits if not summaries[drive][name]]
        if lacking:
            print(f"no {plural}: {'all drives' if len(lacking) == len(splits) else ', '.join(lacking)}")
    return out


def _check_names(drives: list[str], raw: Path) -> None:
    """Raise InputError if a drive named like the sample lies in `raw`, where source both would not read it."""
    for drive in drives:
        folder = raw / drive[:10] / f"{drive}_sync"
        if folder.is_dir():
            raise InputError(
                "drive has a name of the sample, so that ingest.source: both does not read it here",
                folder,
                "Rename its folder to another year, or read it with ingest.source: kitti",
            )


def _ingest(path: Path, *, drive: str, folder: Path, attributes: dict[str, str], settings: Ingest) -> Summary:
    """Write the frames of a drive: those with an oxts packet or, in a drive without oxts, those with an image."""
    raw, params = RawDrive(folder), {"ingest": settings.model_dump(exclude={"drives"})}
    scans = raw.scans if settings.lidar else {}
    number = raw.camera_number(settings.cameras)
    camera = None if number is None else raw.camera(number)
    if scans and (camera is None or camera.T_cam_velo is None):
        problem = "drive has scans, but calib_cam_to_cam.txt or calib_velo_to_cam.txt is missing"
        raise InputError(problem, raw.calibration, "Extract the date's calibration archive, or set ingest.lidar: false")
    images = {} if number is None else {"image": raw.images(number), "depth": raw.truth_depth, "cls": raw.truth_cls}
    images = {name: files for name, files in images.items() if files}
    reader = TolerantReader(tolerant=settings.on_damaged == "skip")

    numbers, times = raw.timeline(number)
    packets = dict(reader.each("oxts", oxts.read_row, raw.oxts, numbers))
    if not packets and (raw.oxts or not numbers or raw.oxts_times.parent.is_dir()):
        fix = "Extract it. Only if labels come from another labels.source: remove the empty folder"
        raise InputError("drive has no oxts packets", raw.oxts_times.parent, fix)
    # Lines of timestamps.txt correspond to existing files, including damaged ones.
    rows = list(packets or range(len(numbers)))
    frames, time_s = [numbers[row] for row in rows], oxts.read_times(times, numbers)[rows]
    with store.DriveWriter(path, stage="ingest", drive=drive, params=params) as file:
        file.attrs |= attributes
        counts = {"frames": len(frames), "oxts": len(packets), "steering": 0}
        file.attrs["camera"] = -1 if number is None else number
        put_motion(file, np.array(frames, np.int32), time_s, np.array(list(packets.values())) if packets else None)
        if raw.steering:
            counts["steering"] = put_steering(file, frames, steering_file.read(raw.steering))
        if camera:
            crop = camera.crop_to(settings.image_size)
            write_camera(file, camera.cropped(crop).scaled(settings.image_size))
        for name, pixels in PIXELS.items():
            arrays = None
            if camera and name in images:
                read = partial(pixels.read, size=camera.size, new_size=settings.image_size, crop=crop)
                arrays = reader.each(name, read, images[name], frames)
            counts[name] = put_pixels(file, name, len(frames), settings.image_size, arrays)
        counts["lidar"] = put_scans(file, len(frames), reader.each("lidar", read_scan, scans, frames))
    others = (set(images.get("image", {})) | set(scans)) - set(numbers)
    return counts | {
        "camera": number,
        "left_out": len(others),
        "damaged": dict(reader.damaged),
    }


def _describe(summary: Summary) -> str:
    """Return the text for a drive's line in the log."""
    text = "{frames} frames, {image} images, {lidar} scans".format_map(summary)
    if summary["image"]:
        text += f", camera {summary['camera']}"
    if summary["depth"] or summary["cls"]:
        text += ", ground truth: {depth} depth, {cls} classes".format_map(summary)
    if summary["steering"]:
        text += f", {summary['steering']} steering angles"
    if summary["left_out"]:
        text += f", {summary['left_out']} without an {'oxts packet' if summary['oxts'] else 'image'} left out"
    for kind, number in summary["damaged"].items():
        text += f", {number} damaged {kind} left out"
    return text


if __name__ == "__main__":
    console.run(main)
