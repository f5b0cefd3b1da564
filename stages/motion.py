"""Stage motion: measure the car's motion since the previous frame, without oxts, data/motion/<kind>/<drive>.h5."""

import shutil
from functools import partial
from pathlib import Path
from typing import get_args

from pipeline.base import console, store
from pipeline.base.params import load
from pipeline.base.runner import Summary
from pipeline.motion import motion_file
from pipeline.motion.estimator import MotionEstimator
from pipeline.perception.drive_frames import DriveFrames, run_over_kinds
from pipeline.sections.motion import Kind, Motion


def main(
    ingest: Path = Path("data/ingest"),
    perception: Path = Path("data/perception"),
    out: Path = Path("data/motion"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Measure each drive's motion from images, from scans, or both: a folder with an index per kind.

    Returns the output folder.
    """
    settings = load(Motion, params)
    splits = store.read_index(perception, stage="perception")
    summaries = run_over_kinds(
        "motion",
        partial(_write, settings=settings),
        settings.kinds,
        list(splits),
        settings,
        ingest=ingest,
        perception=perception,
        out=out,
        workers=workers,
        describe="{frames} frames, {valid} measured".format_map,
    )
    for kind, drives in summaries.items():
        store.write_index(out / kind, splits)
        without = [drive for drive, summary in drives.items() if not summary["valid"]]
        if without:
            print(f"{kind}: no motion measured in {', '.join(without)}")
    for obsolete in set(get_args(Kind)) - set(settings.kinds):  # written by an earlier run
        shutil.rmtree(out / obsolete, ignore_errors=True)
    motion_file.write_index(out, settings.kinds)
    return out


def _write(kind: str, drive: str, frames: DriveFrames, file: store.DriveWriter, *, settings: Motion) -> Summary:
    measured = MotionEstimator(kind, frames.camera, road_scale=settings.road_scale)
    estimates = (measured.estimate(frame) for frame in frames)
    valid = motion_file.write(file, kind, frames.frame, frames.time_s, estimates)
    return {"frames": len(frames.frame), "valid": valid}


if __name__ == "__main__":
    console.run(main)
