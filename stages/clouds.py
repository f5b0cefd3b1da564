"""Stage clouds: lift images and scans into semantic point clouds, data/clouds/{pseudo,lidar}/<drive>.h5."""

from functools import partial
from itertools import product
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.errors import error_context
from pipeline.base.params import load
from pipeline.base.runner import Job, run_over_drives
from pipeline.graphs import cloud
from pipeline.graphs.lift import clouds_drive
from pipeline.settings.clouds import Clouds

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
    jobs = [
        Job(
            f"{kind}/{drive}",
            out / kind / f"{drive}.h5",
            [ingest / f"{drive}.h5", perception / f"{drive}.h5"],
            partial(
                clouds_drive,
                kind=kind,
                ingest=ingest / f"{drive}.h5",
                perception=perception / f"{drive}.h5",
                settings=settings,
            ),
        )
        for kind, drive in product(KINDS, splits)
    ]
    text = "{frames} frames, {points} points"
    with run_over_drives("clouds", settings, jobs, out, text.format_map, workers) as made:
        for kind in KINDS:
            counts = {drive: made[f"{kind}/{drive}"] for drive in splits}
            fix = f"Raise clouds.max_depth_m = {settings.max_depth_m:g}, or check the inputs: steer show {perception}"
            with error_context(f"{params}: clouds/{kind}", fix):
                cloud.check_not_empty(counts, splits)
            store.write_index(out / kind, splits)
            without = [drive for drive, count in counts.items() if not count["frames"]]
            if without:
                print(f"{kind}: no {'scans' if kind == 'lidar' else 'images'} in {', '.join(without)}, so no clouds")
    return out


if __name__ == "__main__":
    console.run(main)
