"""Measure what the car did since the frame before, without oxts: data/motion/<kind>/<drive>.h5."""

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import console, progress, store
from pipeline.base.params import load
from pipeline.base.resume import stage_key
from pipeline.base.runner import Summary, run_over_drives
from pipeline.camera.images import to_metres
from pipeline.motion import kinds, lidar, motion_file, visual
from pipeline.sections.motion import Motion


def main(
    ingest: Path = Path("data/ingest"),
    perception: Path = Path("data/perception"),
    out: Path = Path("data/motion"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Measure each drive's motion in the ways that the params name: a folder for each, with its index.

    Returns the folder that holds them.
    """
    settings = load(Motion, params)
    splits = store.read_index(perception, stage="perception")
    names = [f"{kind}/{drive}" for kind in settings.kinds for drive in splits]

    def key(name: str) -> str:
        inputs = [folder / f"{Path(name).name}.h5" for folder in (ingest, perception)]
        return stage_key("motion", {"name": name, "road_scale": settings.road_scale}, inputs)

    summaries = run_over_drives(
        partial(_measure, ingest=ingest, perception=perception, settings=settings),
        names,
        out=out,
        key=key,
        frames=lambda name: _count(name, ingest, perception),
        workers=workers,
        describe=lambda summary: "{frames} frames, {valid} measured".format_map(summary),
    )
    for kind in settings.kinds:
        store.write_index(out / kind, splits)
        without = [drive for drive in splits if not summaries[f"{kind}/{drive}"]["valid"]]
        if without:
            print(f"{kind}: no motion of {', '.join(without)}")
    for unwanted in KINDS.keys() - settings.kinds:  # of an earlier run
        shutil.rmtree(out / unwanted, ignore_errors=True)
    kinds.write(out, settings.kinds)
    return out


def _count(name: str, ingest: Path, perception: Path) -> int:
    """Return the number of frames whose motion is measured in a kind, named as in :func:`_measure`."""
    kind, drive = name.split("/")
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw,
        store.DriveReader(perception / f"{drive}.h5", stage="perception") as perceived,
    ):
        return int(raw["has_lidar"].sum()) if kind == "lidar" else len(perceived.frame)


def _measure(name: str, path: Path, *, ingest: Path, perception: Path, settings: Motion) -> Summary:
    """Write one drive's motion of one kind, named as visual/2011_09_26_drive_0001."""
    kind, drive = name.split("/")
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw,
        store.DriveReader(perception / f"{drive}.h5", stage="perception") as perceived,
        store.DriveWriter(path, stage="motion", drive=drive, params={"motion": settings.model_dump()}) as file,
    ):
        frame, time_s, begin, read = KINDS[kind](raw, perceived, settings)
        odometry = begin()
        steps = (odometry.step(read(row)) for row, _ in enumerate(progress.track(frame)))
        return {"frames": len(frame), "valid": motion_file.write(file, kind, frame, time_s, steps)}


Frames = tuple[np.ndarray, np.ndarray, Callable[[], Any], Callable[[int], Any]]
"""KITTI frame numbers [F], times [F], what begins a drive's odometry, and how that gets one of these frames."""


def _visual(raw: store.DriveReader, perceived: store.DriveReader, settings: Motion) -> Frames:
    rows = {int(number): row for row, number in enumerate(raw.frame)}

    def read(row: int) -> visual.View:
        number = int(perceived.frame[row])
        depth_m = to_metres(perceived.row("depth_m", row)).astype(np.float32)
        return visual.View(number, raw.row("image", rows[number]), depth_m, perceived.row("cls", row))

    def begin() -> visual.Odometry:
        K = raw["K"] if len(perceived.frame) else np.eye(3)  # a drive without images has no camera
        camera_height_m = float(perceived.attrs["camera_height_m"]) if settings.road_scale else None
        return visual.Odometry(K, perceived.shape("cls")[1:], camera_height_m)

    return perceived.frame, perceived.time_s, begin, read


def _lidar(raw: store.DriveReader, perceived: store.DriveReader, settings: Motion) -> Frames:
    rows, ptr = np.flatnonzero(raw["has_lidar"]), raw["lidar_ptr"]

    def read(index: int) -> lidar.Scan:
        row = rows[index]
        return lidar.Scan(int(raw.frame[row]), raw.rows("lidar", ptr[row], ptr[row + 1]))

    def begin() -> lidar.Odometry:
        return lidar.Odometry(raw["T_cam_velo"] if len(rows) else np.eye(4))  # without scans, nothing is calibrated

    return raw.frame[rows], raw.time_s[rows], begin, read


KINDS: dict[str, Callable[[store.DriveReader, store.DriveReader, Motion], Frames]] = {
    "visual": _visual,
    "lidar": _lidar,
}

if __name__ == "__main__":
    console.run(main)
