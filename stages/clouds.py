"""Stage clouds: lift images and scans into semantic point clouds, data/clouds/{pseudo,lidar}/<drive>.h5."""

from functools import partial
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.errors import error_context
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.base.runner import Job, make_drives
from pipeline.graphs import cloud
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
    for kind in KINDS:
        jobs = []
        for drive in splits:
            inputs = ingest / f"{drive}.h5", perception / f"{drive}.h5"
            work = partial(cloud.clouds_drive, kind=kind, ingest=inputs[0], perception=inputs[1], settings=settings)
            jobs.append(Job(drive, f"{drive}.h5", inputs, work))
        with stage_folder(f"clouds@{kind}", out / kind) as folder:
            counts = make_drives(folder, jobs, settings, "{frames} frames, {points} points".format_map, workers)
            fix = f"Raise clouds.max_depth_m = {settings.max_depth_m:g}, or check the inputs: steer show {perception}"
            with error_context(f"{params}: clouds/{kind}", fix):
                cloud.check_not_empty(counts, splits)
            store.write_index(folder.new, splits)
        without = [drive for drive, count in counts.items() if not count["frames"]]
        if without:
            print(f"{kind}: no {'scans' if kind == 'lidar' else 'images'} in {', '.join(without)}, so no clouds")
    return out


if __name__ == "__main__":
    console.run(main)
