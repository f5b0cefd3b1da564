"""Stage clouds: semantic point clouds of images and scans.

It writes data/clouds/pseudo/<drive>.h5 and data/clouds/lidar/<drive>.h5.
"""

from functools import partial
from pathlib import Path

from pipeline.jobs import console
from pipeline.jobs.outputs import stage_folder
from pipeline.jobs.runner import file_jobs, make_drives

from pipeline.base import store
from pipeline.base.params import load_section
from pipeline.clouds import cloud
from pipeline.clouds.settings import Clouds
from pipeline.ingest.settings import Ingest


def main(data: Path = Path("data"), params: Path = Path("params.yaml")) -> Path:
    """Back-project depth with K⁻¹ (paper eq. 6, 7) and transform LiDAR scans into the camera frame.

    Returns the output folder, which holds the folders pseudo and lidar. If ingest.lidar is false,
    lidar has no drives.
    """
    settings = load_section(Clouds, params)
    out = data / "clouds"
    inputs = {name: data / name for name in ("ingest", "perception")}
    splits = store.read_index(inputs["ingest"], stage="ingest")

    drives = {"pseudo": splits, "lidar": splits}
    if not load_section(Ingest, params).lidar:
        drives["lidar"] = {}

    for kind in drives:
        chosen = settings.of_source(kind)
        work = partial(cloud.clouds_drive, kind=kind, settings=chosen)
        jobs = file_jobs(drives[kind], inputs, work)
        with stage_folder(f"clouds@{kind}", out / kind, drives[kind], params=params) as folder:
            make_drives(folder, jobs, chosen, log_format="{frames} frames, {points} points")
    return out


if __name__ == "__main__":
    console.run(main)
