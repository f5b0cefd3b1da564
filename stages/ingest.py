"""Read raw drives once, and write all that later stages need from them: one HDF5 file per drive."""

from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline import console, images, kitti, oxts, store
from pipeline.classes import VOID
from pipeline.drives import run_over_drives
from pipeline.errors import DamagedFile, InputError
from pipeline.geometry import scale_K
from pipeline.params import Ingest, load

MISSING = {
    "town": "{root} is missing. Make it: dvc repro town",
    "kitti": "{root} is missing. Link it: ln -s /path/to/kitti {root}. Only training? dvc pull labels graphs",
}
# dataset: how to read one frame, channels, dtype, unit, value where a frame has none
PIXELS = {
    "image": (images.read_image, (3,), np.uint8, "RGB", 0),
    "depth": (images.read_depth, (), np.uint16, "1/256 m, 0 = none", 0),
    "cls": (images.read_classes, (), np.uint8, "trainId, 255 = void", VOID),
}


def main(
    town: Path = Path("data/town"),
    raw: Path = Path("data/raw"),
    out: Path = Path("data/ingest"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> None:
    """Read raw drives by frame number: oxts, images, LiDAR scans, calibration, and dense truth where there is any."""
    settings = load(Ingest, params)
    splits = settings.drives.splits()
    root = town if settings.source == "town" else raw
    if not root.is_dir():
        raise InputError(MISSING[settings.source].format(root=root))
    drives = kitti.find_drives(root, list(splits))
    summaries = run_over_drives(
        partial(ingest, drives=drives, splits=splits, settings=settings),
        list(splits),
        module="stages.ingest",
        out=out,
        inputs=lambda drive: [drives[drive].fingerprint(settings.cameras), splits[drive]],
        settings=settings.model_dump(exclude={"drives"}),
        workers=workers,
        describe=describe,
    )
    store.write_index(out, splits)
    for name, what in (("image", "images"), ("lidar", "scans")):
        lacking = [drive for drive, summary in summaries.items() if not summary[name]]
        if lacking:
            print(f"no {what}: {'every drive' if len(lacking) == len(splits) else ', '.join(lacking)}")


def ingest(
    drive: str, path: Path, drives: Mapping[str, kitti.RawDrive], splits: Mapping[str, str], settings: Ingest
) -> dict[str, Any]:
    """Write one drive's file. Its frames are those that have an oxts packet: without one there is no label."""
    raw = drives[drive]
    damaged: Counter[str] = Counter()

    def read(kind: str, reader: Callable[[Path], np.ndarray], file: Path | None) -> np.ndarray | None:
        try:
            return None if file is None else reader(file)
        except DamagedFile as error:
            if settings.on_damaged == "fail":
                raise InputError(
                    f"{error}. Extract it again, or set ingest.on_damaged: skip to leave it out"
                ) from error
            damaged[kind] += 1
            return None

    packets = {frame: read("oxts", oxts.read_row, file) for frame, file in raw.oxts.items()}
    packets = {frame: row for frame, row in packets.items() if row is not None}
    if not packets:
        raise InputError(f"{raw.folder / 'oxts' / 'data'} holds no packets, and labels are made of them: extract it")
    frames = list(packets)
    scans = raw.scans if settings.lidar else {}
    camera = raw.camera(settings.cameras)
    if scans and (camera is None or camera.T_cam_velo is None):
        raise InputError(f"{raw.calibration} lacks calib_cam_to_cam.txt or calib_velo_to_cam.txt: {drive} has scans")
    pixels = {
        "image": raw.images(camera.number) if camera else {},
        "depth": raw.truth_depth if camera else {},
        "cls": raw.truth_cls if camera else {},
    }
    counts = {"frames": len(frames), "camera": camera.number if camera else None}
    dump = settings.model_dump(exclude={"drives"})
    with store.DriveWriter(path, stage="ingest", drive=drive, params={"ingest": dump}) as file:
        file.attrs |= {
            "split": splits[drive],
            "source": settings.source,
            "camera": camera.number if camera else -1,
            "fingerprint": raw.fingerprint(settings.cameras),
        }
        file.put("frame", np.array(frames, np.int32))
        file.put("time_s", oxts.read_times(raw.oxts_times, frames), "s")
        file.put("oxts", np.array(list(packets.values())), "as KITTI's oxts/dataformat.txt")
        if camera:
            file.put("K", scale_K(camera.K, camera.size, settings.image_size), "pixels")
        if camera and camera.T_cam_velo is not None:
            file.put("T_cam_velo", camera.T_cam_velo, "m")

        for name, (reader, channels, dtype, unit, absent) in PIXELS.items():
            has = np.zeros(len(frames), np.uint8)
            if pixels[name] or name == "image":
                file.blank(name, (len(frames), *settings.image_size, *channels), dtype, unit, value=absent)
            for index, frame in enumerate(frames):
                resized = partial(reader, size=camera.size if camera else (0, 0), new_size=settings.image_size)
                array = read(name, resized, pixels[name].get(frame))
                if array is not None:
                    file.fill(name, index, array)
                    has[index] = 1
            file.put(f"has_{name}", has)
            counts[name] = int(has.sum())

        points = []
        for frame in frames:
            scan = read("lidar", kitti.read_scan, scans.get(frame))
            file.append("lidar", np.zeros((0, 4), np.float32) if scan is None else scan, "m, m, m, reflectance")
            points.append(0 if scan is None else len(scan))
        file.put("lidar_ptr", store.pointers(points), "rows of lidar")
        file.put("has_lidar", np.array(points, bool).astype(np.uint8))
        counts["lidar"] = int(np.count_nonzero(points))
    unlabelled = (set(pixels["image"]) | set(scans)) - set(raw.oxts)
    return counts | {"damaged": dict(damaged), "without_oxts": len(unlabelled)}


def describe(summary: Mapping[str, Any]) -> str:
    """Return what the log says of one drive."""
    text = "{frames} frames, {image} images, {lidar} scans".format_map(summary)
    if summary["image"]:
        text += f", camera {summary['camera']}"
    if summary["depth"] or summary["cls"]:
        text += ", {depth} depth and {cls} class truths".format_map(summary)
    if summary["without_oxts"]:
        text += f", {summary['without_oxts']} frames left out for want of an oxts packet"
    for kind, number in summary["damaged"].items():
        text += f", {number} damaged {kind} left out"
    return text


if __name__ == "__main__":
    console.run(main)
