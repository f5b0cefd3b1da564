"""Measure what the car did since the frame before, without oxts: data/motion/<kind>/<drive>.h5."""

import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.base import console, progress, store
from pipeline.base.params import load
from pipeline.base.pool import Summary, run_over_drives
from pipeline.camera.images import to_metres
from pipeline.motion import kinds, lidar, motion_file, visual
from pipeline.motion.step import Step
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
    summaries = run_over_drives(
        partial(_measure, ingest=ingest, perception=perception, settings=settings),
        names,
        module="stages.motion",
        out=out,
        inputs=lambda name: [folder / f"{Path(name).name}.h5" for folder in (ingest, perception)],
        settings={"road_scale": settings.road_scale},
        workers=workers,
        describe=lambda summary: "{frames} frames, {valid} measured".format_map(summary),
    )
    for kind in settings.kinds:
        store.write_index(out / kind, splits)
        without = [drive for drive in splits if not summaries[f"{kind}/{drive}"]["valid"]]
        if without:
            print(f"{kind}: no motion of {', '.join(without)}")
    for stale in KINDS.keys() - settings.kinds:  # of an earlier run
        shutil.rmtree(out / stale, ignore_errors=True)
    kinds.write(out, settings.kinds)
    return out


def _measure(name: str, path: Path, *, ingest: Path, perception: Path, settings: Motion) -> Summary:
    """Write one drive's motion of one kind, named as visual/2011_09_26_drive_0001."""
    kind, drive = name.split("/")
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw,
        store.DriveReader(perception / f"{drive}.h5", stage="perception") as perceived,
        store.DriveWriter(path, stage="motion", drive=drive, params={"motion": settings.model_dump()}) as file,
    ):
        frame, time_s, steps = KINDS[kind](raw, perceived, settings)
        return {"frames": len(frame), "valid": motion_file.write(file, kind, frame, time_s, _counted(steps))}


def _counted(steps: Iterator[Step | None]) -> Iterator[Step | None]:
    for step in steps:
        progress.advance(1)
        yield step


Frames = tuple[np.ndarray, np.ndarray, Iterator[Step | None]]
"""KITTI frame numbers [F], times [F], and each one's motion since the one before."""


def _visual(raw: store.DriveReader, perceived: store.DriveReader, settings: Motion) -> Frames:
    rows = {int(number): row for row, number in enumerate(raw.frame)}
    views = (
        visual.View(
            int(number),
            raw.row("image", rows[int(number)]),
            to_metres(perceived.row("depth_m", row)).astype(np.float32),
            perceived.row("cls", row),
        )
        for row, number in enumerate(perceived.frame)
    )
    K = raw["K"] if len(perceived.frame) else np.eye(3)  # a drive without images has no camera
    camera_height_m = float(perceived.attrs["camera_height_m"]) if settings.road_scale else None
    return perceived.frame, perceived.time_s, visual.steps(views, K, camera_height_m)


def _lidar(raw: store.DriveReader, perceived: store.DriveReader, settings: Motion) -> Frames:
    rows, ptr = np.flatnonzero(raw["has_lidar"]), raw["lidar_ptr"]
    scans = (lidar.Scan(int(raw.frame[row]), raw.rows("lidar", ptr[row], ptr[row + 1])) for row in rows)
    T_cam_velo = raw["T_cam_velo"] if len(rows) else np.eye(4)  # a drive without scans may have no calibration
    return raw.frame[rows], raw.time_s[rows], lidar.steps(scans, T_cam_velo)


KINDS: dict[str, Callable[[store.DriveReader, store.DriveReader, Motion], Frames]] = {
    "visual": _visual,
    "lidar": _lidar,
}

if __name__ == "__main__":
    console.run(main)
