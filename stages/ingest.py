"""Read raw drives once, and write all that later stages need from them: one HDF5 file per drive."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import console, progress, store
from pipeline.base.errors import InputError
from pipeline.base.params import load
from pipeline.base.resume import stage_key
from pipeline.base.runner import Summary, run_over_drives
from pipeline.camera.geometry import scale_K
from pipeline.kitti import oxts
from pipeline.kitti.ingest_file import PIXELS, put_camera, put_motion, put_pixels, put_scans
from pipeline.kitti.raw import RawDrive, find_drives, read_scan
from pipeline.kitti.tolerant import TolerantReader
from pipeline.sections.ingest import SAMPLE, Ingest

MISSING = {
    "town": "{root} is missing. Make it: dvc repro town",
    "kitti": "{root} is missing. Link it: ln -s /path/to/kitti {root}. Only training? dvc pull labels graphs",
}


def main(
    town: Path = Path("data/town"),
    raw: Path = Path("data/raw"),
    out: Path = Path("data/ingest"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Read raw drives by frame number: oxts, images, LiDAR scans, calibration, and dense truth where there is any.

    Returns the folder that it wrote.
    """
    settings = load(Ingest, params)
    splits, sources = settings.drives.splits(), settings.sources()
    roots = {"town": town, "kitti": raw}
    drives: dict[str, RawDrive] = {}
    for drive in splits if settings.source == "both" else ():
        if sources[drive] == "town" and (raw / drive[:10] / f"{drive}_sync").is_dir():
            raise InputError(
                f"{drive} lies in {raw}, but with ingest.source: both what is called {SAMPLE}… is the sample's: give "
                "its folder a date of another year, or read it with source: kitti, without the sample"
            )
    for source, root in roots.items():
        names = [drive for drive in splits if sources[drive] == source]
        if names and not root.is_dir():
            raise InputError(MISSING[source].format(root=root))
        drives |= find_drives(root, names) if names else {}
    attributes = {
        drive: {"split": splits[drive], "source": sources[drive], "fingerprint": files.fingerprint(settings.cameras)}
        for drive, files in drives.items()
    }

    def key(drive: str) -> str:
        inputs = [*attributes[drive].values(), drives[drive].changes(settings.cameras)]
        return stage_key("ingest", {"drive": drive, **settings.model_dump(mode="json", exclude={"drives"})}, inputs)

    summaries = run_over_drives(
        partial(_ingest, drives=drives, attributes=attributes, settings=settings),
        list(splits),
        out=out,
        key=key,
        frames=lambda drive: len(drives[drive].oxts),
        workers=workers,
        describe=describe,
    )
    store.write_index(out, splits)
    for name, what in (("image", "images"), ("lidar", "scans")):
        lacking = [drive for drive, summary in summaries.items() if not summary[name]]
        if lacking:
            print(f"no {what}: {'every drive' if len(lacking) == len(splits) else ', '.join(lacking)}")
    return out


def _ingest(
    drive: str,
    path: Path,
    *,
    drives: Mapping[str, RawDrive],
    attributes: Mapping[str, Mapping[str, str]],
    settings: Ingest,
) -> Summary:
    params = {"ingest": settings.model_dump(exclude={"drives"})}
    with store.DriveWriter(path, stage="ingest", drive=drive, params=params) as file:
        file.attrs |= attributes[drive]
        return ingest(file, drives[drive], settings)


def ingest(file: store.DriveWriter, raw: RawDrive, settings: Ingest) -> Summary:
    """Write a drive's frames, by their oxts packets: a frame without one has no label."""
    numbers, packets = list(raw.oxts), raw.folder / "oxts" / "data"
    reader = TolerantReader(tolerant=settings.on_damaged == "skip")
    sound = dict(reader.each("oxts", oxts.read_row, raw.oxts, numbers))
    if not sound:
        raise InputError("no packets, which labels are made of", packets, "Extract it")
    frames = [numbers[row] for row in sound]
    # Lines of timestamps.txt go with the packets that are there, damaged ones too.
    time_s = oxts.read_times(raw.oxts_times, numbers)[list(sound)]
    scans = raw.scans if settings.lidar else {}
    camera = raw.camera(settings.cameras)
    if scans and (camera is None or camera.T_cam_velo is None):
        raise InputError(
            f"calib_cam_to_cam.txt or calib_velo_to_cam.txt is missing, and {raw.folder.name} has scans",
            raw.calibration,
        )
    pictures = {"image": raw.images(camera.number), "depth": raw.truth_depth, "cls": raw.truth_cls} if camera else {}

    file.attrs["camera"] = camera.number if camera else -1
    put_motion(file, np.array(frames, np.int32), time_s, np.array(list(sound.values())).reshape(-1, len(oxts.COLUMNS)))
    if camera:
        put_camera(file, scale_K(camera.K, camera.size, settings.image_size), camera.T_cam_velo)
    counts = {"frames": len(frames)}
    for name, pixels in PIXELS.items():
        made = None
        if camera and pictures[name]:
            read = partial(pixels.read, size=camera.size, new_size=settings.image_size)
            made = reader.each(name, read, pictures[name], frames)
        counts[name] = put_pixels(file, name, len(frames), settings.image_size, made)
    counts["lidar"] = put_scans(file, len(frames), reader.each("lidar", read_scan, scans, frames))
    progress.advance(len(numbers))  # all at once: images come first, then scans
    unlabelled = (set(pictures.get("image", {})) | set(scans)) - set(raw.oxts)
    return counts | {
        "camera": camera.number if camera else None,
        "without_oxts": len(unlabelled),
        "damaged": dict(reader.damaged),
    }


def describe(summary: Mapping[str, Any]) -> str:
    """Return what the log says of one drive."""
    text = "{frames} frames, {image} images, {lidar} scans".format_map(summary)
    if summary["image"]:
        text += f", camera {summary['camera']}"
    if summary["depth"] or summary["cls"]:
        text += ", {depth} depth and {cls} class truths".format_map(summary)
    if summary["without_oxts"]:
        text += f", {summary['without_oxts']} without an oxts packet left out"
    for kind, number in summary["damaged"].items():
        text += f", {number} damaged {kind} left out"
    return text


if __name__ == "__main__":
    console.run(main)
