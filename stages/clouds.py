"""Stage clouds: lift images and scans into semantic point clouds, data/clouds/{pseudo,lidar}/<drive>.h5."""

from functools import partial
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.errors import error_context
from pipeline.base.params import load
from pipeline.base.runner import Summary
from pipeline.graphs import cloud
from pipeline.perception.drive_frames import DriveFrames, run_over_kinds
from pipeline.sections.clouds import Clouds

KINDS = ("pseudo", "lidar")


def main(
    ingest: Path = Path("data/ingest"),
    perception: Path = Path("data/perception"),
    out: Path = Path("data/clouds"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Back-project depth with K⁻¹ (paper eq. 6, 7) and transform LiDAR scans into the camera frame.

    Returns the output folder, which holds the folders pseudo and lidar.
    """
    settings = load(Clouds, params)
    splits = store.read_index(ingest, stage="ingest")
    summaries = run_over_kinds(
        "clouds",
        partial(_write, settings=settings),
        KINDS,
        list(splits),
        settings,
        ingest=ingest,
        perception=perception,
        out=out,
        workers=workers,
        describe="{frames} frames, {points} points".format_map,
    )
    for kind, drives in summaries.items():
        fix = f"Raise clouds.max_depth_m = {settings.max_depth_m:g}, or check the inputs: steer show {perception}"
        with error_context(f"{params}: clouds/{kind}", fix):
            cloud.check_not_empty(drives, splits)
        store.write_index(out / kind, splits)
        without = [drive for drive, summary in drives.items() if not summary["frames"]]
        if without:
            print(f"{kind}: no {'scans' if kind == 'lidar' else 'images'} in {', '.join(without)}, so no clouds")
    return out


def _write(kind: str, drive: str, frames: DriveFrames, file: store.DriveWriter, *, settings: Clouds) -> Summary:
    clouds = (cloud.stored_cloud(frame, kind, frames.camera, drive, settings) for frame in frames)
    return cloud.write(file, frames.frame, frames.time_s, clouds)


if __name__ == "__main__":
    console.run(main)
