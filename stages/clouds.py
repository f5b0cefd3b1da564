"""Lift images and scans into semantic point clouds, the shared cache: data/clouds/{pseudo,lidar}/<drive>.h5."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.base import console, store
from pipeline.base import pool as drives
from pipeline.base.params import load
from pipeline.graphs import cloud
from pipeline.sections.clouds import Clouds

Cloud = tuple[np.ndarray, np.ndarray]  # xyz [P,3], cls [P]


def main(
    ingest: Path = Path("data/ingest"),
    perception: Path = Path("data/perception"),
    out: Path = Path("data/clouds"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> None:
    """Back-project depth with K⁻¹ (paper eq. 6, 7) and bring LiDAR scans into the camera frame."""
    section = load(Clouds, params)
    splits = store.read_index(ingest, stage="ingest")
    # One run for both kinds: a stage that is killed keeps what is finished of either.
    names = [f"{kind}/{drive}" for kind in KINDS for drive in splits]
    summaries = drives.run_over_drives(
        partial(_clouds, ingest=ingest, perception=perception, section=section),
        names,
        module="stages.clouds",
        out=out,
        inputs=lambda name: [folder / f"{Path(name).name}.h5" for folder in (ingest, perception)],
        settings={"clouds": section.model_dump()},
        workers=workers,
        describe=lambda summary: f"{summary['frames']} frames, {summary['points']} points",
    )
    for kind in KINDS:
        store.write_index(out / kind, splits)
        empty = [drive for drive in splits if not summaries[f"{kind}/{drive}"]["frames"]]
        if empty:
            print(f"{kind}: no clouds for {', '.join(empty)} (nothing to make them from)")


def _clouds(name: str, path: Path, ingest: Path, perception: Path, section: Clouds) -> drives.Summary:
    kind, drive = name.split("/")
    return KINDS[kind](drive, path, ingest, perception, section)


def _pseudo(drive: str, path: Path, ingest: Path, perception: Path, section: Clouds) -> drives.Summary:
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw,
        store.DriveReader(perception / f"{drive}.h5", stage="perception") as seen,
    ):

        def frame(row: int) -> Cloud:
            depth_m = seen.row("depth_m", row) / 256.0
            return cloud.pseudo_cloud(depth_m, seen.row("cls", row), raw["K"], section.max_depth_m)

        return _write(path, drive, section, seen.frame, seen.time_s, frame)


def _lidar(drive: str, path: Path, ingest: Path, perception: Path, section: Clouds) -> drives.Summary:
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw,
        store.DriveReader(perception / f"{drive}.h5", stage="perception") as seen,
    ):
        rows = np.flatnonzero(raw["has_lidar"])
        image_row = {int(number): row for row, number in enumerate(seen.frame)}
        ptr = raw["lidar_ptr"]

        def frame(index: int) -> Cloud:
            row = rows[index]
            image = image_row.get(int(raw.frame[row]))
            cls = None if image is None else seen.row("cls", image)
            return cloud.lidar_cloud(raw.rows("lidar", ptr[row], ptr[row + 1]), raw["T_cam_velo"], raw["K"], cls)

        return _write(path, drive, section, raw.frame[rows], raw.time_s[rows], frame)


def _write(
    path: Path, drive: str, section: Clouds, numbers: np.ndarray, time_s: np.ndarray, frame: Callable[[int], Cloud]
) -> drives.Summary:
    """Write the clouds ``frame(0)``, ``frame(1)``, … of the KITTI frames `numbers`."""
    counts = []
    with store.DriveWriter(path, stage="clouds", drive=drive, params={"clouds": section.model_dump()}) as file:
        file.put("frame", numbers)
        file.put("time_s", time_s, unit="s")
        file.append("xyz", np.empty((0, 3), np.float32), unit="m")
        file.append("cls", np.empty(0, np.uint8), unit="trainId")
        for index, number in enumerate(numbers):
            xyz, cls = frame(index)
            chosen = cloud.sample(len(xyz), section.max_points, cloud.frame_rng(section.seed, drive, int(number)))
            xyz, cls = cloud.quantise(xyz[chosen]), cls[chosen]
            order = cloud.morton_order(xyz)
            file.append("xyz", xyz[order])
            file.append("cls", cls[order])
            counts.append(len(xyz))
        file.put("ptr", store.pointers(counts), unit="row")
    return {"frames": len(counts), "points": sum(counts)}


KINDS = {"pseudo": _pseudo, "lidar": _lidar}

if __name__ == "__main__":
    console.run(main)
