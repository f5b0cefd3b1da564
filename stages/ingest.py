"""Read raw drives once, and write all that later stages need from them: one HDF5 file per drive."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import console, progress, store
from pipeline.base.errors import InputError
from pipeline.base.params import load
from pipeline.base.pool import run_over_frames
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

NO_PACKETS = "{folder} holds no packets, and labels are made of them: extract it"


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
    dump = settings.model_dump(exclude={"drives"})
    summaries = run_over_frames(
        Ingester(roots, attributes, settings),
        list(splits),
        stage="ingest",
        params={"ingest": dump},
        frames=lambda drive: list(drives[drive].oxts),
        out=out,
        inputs=lambda drive: [*attributes[drive].values(), drives[drive].changes(settings.cameras)],
        settings=dump,
        workers=workers,
        total=total,
        describe=describe,
    )
    store.write_index(out, splits)
    for name, what in (("image", "images"), ("lidar", "scans")):
        lacking = [drive for drive, summary in summaries.items() if not summary[name]]
        if lacking:
            print(f"no {what}: {'every drive' if len(lacking) == len(splits) else ', '.join(lacking)}")
    return out


@dataclass
class Ingester:
    """Writes frames of drives; it keeps the last drive's list of files from one block to the next."""

    roots: Mapping[str, Path]
    attributes: Mapping[str, Mapping[str, str]]
    settings: Ingest
    listed: dict[str, RawDrive] = field(default_factory=dict)

    def __call__(self, drive: str, rows: range, file: store.DriveWriter) -> dict[str, Any]:
        """Write some frames of a drive, `rows` of its oxts packets, and return what the log says of them."""
        if drive not in self.listed:
            self.listed = find_drives(self.roots[self.attributes[drive]["source"]], [drive])
        return ingest(drive, rows, file, self.listed[drive], self.attributes[drive], self.settings)


def ingest(
    drive: str, rows: range, file: store.DriveWriter, raw: RawDrive, attributes: Mapping[str, str], settings: Ingest
) -> dict[str, Any]:
    """Write some frames of a drive, `rows` of its oxts packets: a frame without one has no label."""
    numbers, packets = list(raw.oxts), raw.folder / "oxts" / "data"
    if not numbers:
        raise InputError(NO_PACKETS.format(folder=packets))
    reader = TolerantReader(tolerant=settings.on_damaged == "skip")
    sound = dict(reader.each("oxts", oxts.read_row, raw.oxts, numbers[rows.start : rows.stop]))
    frames = [numbers[rows.start + row] for row in sound]
    # Lines of timestamps.txt go with the packets that are there, damaged ones too.
    time_s = oxts.read_times(raw.oxts_times, numbers)[rows.start : rows.stop][list(sound)]
    scans = raw.scans if settings.lidar else {}
    camera = raw.camera(settings.cameras)
    if scans and (camera is None or camera.T_cam_velo is None):
        raise InputError(f"{raw.calibration} lacks calib_cam_to_cam.txt or calib_velo_to_cam.txt: {drive} has scans")
    pictures = {"image": raw.images(camera.number), "depth": raw.truth_depth, "cls": raw.truth_cls} if camera else {}

    file.attrs |= {**attributes, "camera": camera.number if camera else -1}
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
    progress.advance(len(rows))  # all at once: images come first, then scans
    unlabelled = (set(pictures.get("image", {})) | set(scans)) - set(raw.oxts)
    of_drive = {"camera": camera.number if camera else None, "without_oxts": len(unlabelled), "packets": str(packets)}
    return {"counts": counts, "damaged": dict(reader.damaged), "of_drive": of_drive}


def total(blocks: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return a drive's summary from those of its blocks. Raises InputError if every packet is damaged."""
    counts, damaged, of_drive = Counter[str](), Counter[str](), blocks[0]["of_drive"]
    for block in blocks:
        counts.update(block["counts"])  # keeps zeros
        damaged.update(block["damaged"])
    if not counts["frames"]:
        raise InputError(NO_PACKETS.format(folder=of_drive["packets"]))
    return {**counts, **of_drive, "damaged": damaged}


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
