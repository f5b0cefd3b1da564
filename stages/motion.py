"""Stage motion: measure the car's motion since the previous frame, without oxts, data/motion/<kind>/<drive>.h5."""

from contextlib import suppress
from functools import partial
from itertools import product
from pathlib import Path
from typing import get_args

from pipeline.base import console, store
from pipeline.base.params import MotionKind, load
from pipeline.base.runner import Job, Summary, run_over_drives
from pipeline.motion import motion_file
from pipeline.motion.estimator import MotionEstimator
from pipeline.perception.drive_frames import open_frames
from pipeline.settings.motion import Motion


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
    jobs = [
        Job(
            f"{kind}/{drive}",
            out / kind / f"{drive}.h5",
            [ingest / f"{drive}.h5", perception / f"{drive}.h5"],
            partial(_write, kind=kind, drive=drive, ingest=ingest, perception=perception, settings=settings),
        )
        for kind, drive in product(settings.kinds, splits)
    ]
    text = "{frames} frames, {valid} measured"
    with run_over_drives("motion", settings, jobs, out, text.format_map, workers) as made:
        for kind in settings.kinds:
            store.write_index(out / kind, splits)
            without = [drive for drive in splits if not made[f"{kind}/{drive}"]["valid"]]
            if without:
                print(f"{kind}: no motion measured in {', '.join(without)}")
        for obsolete in set(get_args(MotionKind)) - set(settings.kinds):  # written by an earlier run
            _remove(out / obsolete)
        visual = [made[f"visual/{drive}"] for drive in splits] if "visual" in settings.kinds else []
        frames = sum(summary["frames"] for summary in visual)
        road_frames = sum(summary["road_frames"] for summary in visual) / frames if frames else None
        motion_file.write_index(out, settings.kinds, road_frames)
        if problem := motion_file.uncertain_scale(out):
            print(f"visual: {problem}, so the speed is uncertain")
    return out


def _remove(folder: Path) -> None:
    """Remove the files that this stage wrote to `folder`, and `folder` if nothing else is in it."""
    drives = store.indexed(folder)
    for name in ("index.json", *(f"{drive}.h5" for drive in drives)) if drives else ():
        (folder / name).unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def _write(path: Path, *, kind: str, drive: str, ingest: Path, perception: Path, settings: Motion) -> Summary:
    with (
        open_frames(ingest, perception, drive, kind) as frames,
        store.DriveWriter(path, stage="motion", drive=drive, params={"motion": settings.model_dump()}) as file,
    ):
        motion = MotionEstimator(kind, frames.camera, road_scale=settings.road_scale)
        estimates = (motion.estimate(frame) for frame in frames)
        valid = motion_file.write(file, kind, frames.frame, frames.time_s, estimates)
        return {"frames": len(frames.frame), "valid": valid, "road_frames": motion.road_frames}


if __name__ == "__main__":
    console.run(main)
