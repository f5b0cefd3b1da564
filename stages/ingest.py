"""Read raw drives once, and write all that later stages need from them: one HDF5 file per drive."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import console, store
from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.params import load
from pipeline.base.pool import run_over_drives
from pipeline.camera import images
from pipeline.camera.classes import VOID
from pipeline.camera.geometry import scale_K
from pipeline.kitti import oxts
from pipeline.kitti import raw as kitti
from pipeline.sections.ingest import Ingest

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
    found = kitti.find_drives(root, list(splits))
    attributes = {
        drive: {"split": splits[drive], "source": settings.source, "fingerprint": files.fingerprint(settings.cameras)}
        for drive, files in found.items()
    }
    summaries = run_over_drives(
        partial(ingest, root=root, attributes=attributes, settings=settings),
        list(splits),
        module="stages.ingest",
        out=out,
        inputs=lambda drive: [*attributes[drive].values(), found[drive].changes(settings.cameras)],
        settings=settings.model_dump(exclude={"drives"}),
        workers=workers,
        effort=lambda drive: len(found[drive].oxts),
        describe=describe,
    )
    store.write_index(out, splits)
    # `graphs` depends on data/clouds/<cloud>. For a variant with cloud: none that is this file, which changes when what
    # the variant copies from here changes, and only then.
    seen = {drive: {"split": splits[drive], "sha256": summary["sha256"]} for drive, summary in summaries.items()}
    store.write_json(out.parent / "clouds/none/images.json", seen)
    for name, what in (("image", "images"), ("lidar", "scans")):
        lacking = [drive for drive, summary in summaries.items() if not summary[name]]
        if lacking:
            print(f"no {what}: {'every drive' if len(lacking) == len(splits) else ', '.join(lacking)}")


def ingest(
    drive: str, path: Path, root: Path, attributes: Mapping[str, Mapping[str, str]], settings: Ingest
) -> dict[str, Any]:
    """Write one drive's file. Its frames are those that have an oxts packet: without one there is no label."""
    raw = kitti.find_drives(root, [drive])[drive]
    read = TolerantReader(tolerant=settings.on_damaged == "skip")
    packets = {frame: read("oxts", oxts.read_row, file) for frame, file in raw.oxts.items()}
    packets = {frame: row for frame, row in packets.items() if row is not None}
    if not packets:
        raise InputError(f"{raw.folder / 'oxts' / 'data'} holds no packets, and labels are made of them: extract it")
    frames = list(packets)
    # Lines of timestamps.txt go with the packets that are there, damaged ones too.
    time_s = oxts.read_times(raw.oxts_times, list(raw.oxts))[np.isin(list(raw.oxts), frames)]
    scans = raw.scans if settings.lidar else {}
    camera = raw.camera(settings.cameras)
    if scans and (camera is None or camera.T_cam_velo is None):
        raise InputError(f"{raw.calibration} lacks calib_cam_to_cam.txt or calib_velo_to_cam.txt: {drive} has scans")
    pictures = {}
    if camera:
        pictures = {"image": raw.images(camera.number), "depth": raw.truth_depth, "cls": raw.truth_cls}

    counts: dict[str, Any] = {"frames": len(frames), "camera": camera.number if camera else None}
    dump = settings.model_dump(exclude={"drives"})
    with store.DriveWriter(path, stage="ingest", drive=drive, params={"ingest": dump}) as file:
        file.attrs |= {**attributes[drive], "camera": camera.number if camera else -1}
        file.put("frame", np.array(frames, np.int32))
        file.put("time_s", time_s, "s")
        file.put("oxts", np.array(list(packets.values())), "as KITTI's oxts/dataformat.txt")
        if camera:
            file.put("K", scale_K(camera.K, camera.size, settings.image_size), "pixels")
        if camera and camera.T_cam_velo is not None:
            file.put("T_cam_velo", camera.T_cam_velo, "m")

        digest = hashlib.sha256()  # of the images, their size, frame numbers and times
        digest.update(np.array(settings.image_size).tobytes())
        for name, (reader, channels, dtype, unit, absent) in PIXELS.items():
            files = pictures.get(name, {})
            has = np.zeros(len(frames), np.uint8)
            if files or name == "image":
                file.blank(name, (len(frames), *settings.image_size, *channels), dtype, unit, value=absent)
            if files and camera:
                resized = partial(reader, size=camera.size, new_size=settings.image_size)
                for index, pixels in read.each(name, resized, files, frames):
                    file.fill(name, index, pixels)
                    has[index] = 1
                    if name == "image":
                        digest.update(np.array([frames[index], time_s[index]]).tobytes() + pixels.tobytes())
            file.put(f"has_{name}", has)
            counts[name] = int(has.sum())

        points = np.zeros(len(frames), np.int64)
        file.append("lidar", np.zeros((0, 4), np.float32), "m, m, m, reflectance")
        for index, scan in read.each("lidar", kitti.read_scan, scans, frames):
            file.append("lidar", scan)
            points[index] = len(scan)
        file.put("lidar_ptr", store.pointers(points), "rows of lidar")
        file.put("has_lidar", (points > 0).astype(np.uint8))
        counts["lidar"] = int(np.count_nonzero(points))
    unlabelled = (set(pictures.get("image", {})) | set(scans)) - set(raw.oxts)
    counts["sha256"] = digest.hexdigest()
    return counts | {"damaged": dict(read.damaged), "without_oxts": len(unlabelled)}


class TolerantReader:
    """Reads files of single frames; a damaged one is an error, or, if `tolerant`, None and counted by kind."""

    def __init__(self, tolerant: bool) -> None:
        self._tolerant = tolerant
        self.damaged: Counter[str] = Counter()

    def __call__(self, kind: str, reader: Callable[[Path], np.ndarray], file: Path) -> np.ndarray | None:
        try:
            return reader(file)
        except DamagedFile as error:
            if not self._tolerant:
                advice = "Extract it again, or set ingest.on_damaged: skip to leave it out"
                raise InputError(f"{error}. {advice}") from error
            self.damaged[kind] += 1
            return None

    def each(
        self, kind: str, reader: Callable[[Path], np.ndarray], files: Mapping[int, Path], frames: Sequence[int]
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Yield (position in `frames`, array) for each of `frames` that has a sound file."""
        for index, frame in enumerate(frames):
            array = self(kind, reader, files[frame]) if frame in files else None
            if array is not None:
                yield index, array


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
