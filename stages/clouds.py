"""Lift images and scans into semantic point clouds, the shared cache: data/clouds/{pseudo,lidar}/<drive>.h5."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.base import console, progress, store
from pipeline.base.errors import error_context
from pipeline.base.params import load
from pipeline.base.resume import stage_key
from pipeline.base.runner import Summary, run_over_drives
from pipeline.camera.images import to_metres
from pipeline.graphs import cloud
from pipeline.sections.clouds import Clouds


def main(
    ingest: Path = Path("data/ingest"),
    perception: Path = Path("data/perception"),
    out: Path = Path("data/clouds"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Back-project depth with K⁻¹ (paper eq. 6, 7) and bring LiDAR scans into the camera frame.

    Returns the folder that it wrote, with the folders pseudo and lidar.
    """
    settings = load(Clouds, params)
    splits = store.read_index(ingest, stage="ingest")
    # One run for both kinds: a stage that is killed keeps what is finished of either.
    names = [f"{kind}/{drive}" for kind in KINDS for drive in splits]
    dump = settings.model_dump(mode="json")

    def key(name: str) -> str:
        drive = Path(name).name
        return stage_key("clouds", {"name": name, **dump}, [folder / f"{drive}.h5" for folder in (ingest, perception)])

    summaries = run_over_drives(
        partial(_clouds, ingest=ingest, perception=perception, settings=settings),
        names,
        out=out,
        key=key,
        frames=lambda name: _count(name, ingest, perception),
        workers=workers,
        describe=lambda summary: f"{summary['frames']} frames, {summary['points']} points",
    )
    for kind in KINDS:
        hint = f"Raise clouds.max_depth_m = {settings.max_depth_m:g}, or see what they hold: steer show {perception}"
        with error_context(f"{params}: clouds/{kind}", fix=hint):
            cloud.check_any({drive: summaries[f"{kind}/{drive}"] for drive in splits}, splits)
        store.write_index(out / kind, splits)
        empty = [drive for drive in splits if not summaries[f"{kind}/{drive}"]["frames"]]
        if empty:
            print(f"{kind}: no clouds for {', '.join(empty)} (nothing to make them from)")
    return out


def _count(name: str, ingest: Path, perception: Path) -> int:
    """Return the number of frames that have a cloud of a kind, named as in :func:`_clouds`."""
    kind, drive = name.split("/")
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw,
        store.DriveReader(perception / f"{drive}.h5", stage="perception") as perceived,
    ):
        return int(raw["has_lidar"].sum()) if kind == "lidar" else len(perceived.frame)


def _clouds(name: str, path: Path, *, ingest: Path, perception: Path, settings: Clouds) -> Summary:
    """Write one drive's clouds of one kind, named as pseudo/2011_09_26_drive_0001."""
    kind, drive = name.split("/")
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw,
        store.DriveReader(perception / f"{drive}.h5", stage="perception") as perceived,
        store.DriveWriter(path, stage="clouds", drive=drive, params={"clouds": settings.model_dump()}) as file,
    ):
        frame, time_s, make = KINDS[kind](raw, perceived, settings)
        clouds = (
            cloud.stored(make(row), settings.max_points, cloud.frame_rng(settings.seed, drive, int(number)))
            for row, number in enumerate(progress.track(frame))
        )
        return cloud.write(file, frame, time_s, clouds)


Frames = tuple[np.ndarray, np.ndarray, Callable[[int], cloud.Cloud]]
"""KITTI frame numbers [F], times [F], and how the cloud of a row of these is made."""


def _pseudo(raw: store.DriveReader, perceived: store.DriveReader, settings: Clouds) -> Frames:
    def make(row: int) -> cloud.Cloud:
        depth_m = to_metres(perceived.row("depth_m", row))
        return cloud.pseudo_cloud(depth_m, perceived.row("cls", row), raw["K"], settings.max_depth_m)

    return perceived.frame, perceived.time_s, make


def _lidar(raw: store.DriveReader, perceived: store.DriveReader, settings: Clouds) -> Frames:
    rows, ptr = np.flatnonzero(raw["has_lidar"]), raw["lidar_ptr"]
    image_row = {int(number): row for row, number in enumerate(perceived.frame)}

    def make(index: int) -> cloud.Cloud:
        row = rows[index]
        image = image_row.get(int(raw.frame[row]))
        cls = None if image is None else perceived.row("cls", image)
        return cloud.lidar_cloud(raw.rows("lidar", ptr[row], ptr[row + 1]), raw["T_cam_velo"], raw["K"], cls)

    return raw.frame[rows], raw.time_s[rows], make


KINDS = {"pseudo": _pseudo, "lidar": _lidar}

if __name__ == "__main__":
    console.run(main)
