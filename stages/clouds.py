"""Stage clouds: lift images and scans into semantic point clouds,
data/clouds/{pseudo,lidar}/<drive>.h5.
"""

from functools import partial
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.base.runner import file_jobs, make_drives
from pipeline.clouds import cloud
from pipeline.clouds.settings import Clouds
from pipeline.ingest.settings import Ingest


def main(data: Path = Path("data"), params: Path = Path("params.yaml")) -> Path:
    """Back-project depth with K⁻¹ (paper eq. 6, 7) and transform LiDAR scans into the camera frame.

    Returns the output folder, which holds the folders pseudo and lidar; lidar has no drives without
    ingest.lidar.
    """
    settings, out = load(Clouds, params), data / "clouds"
    inputs = {name: data / name for name in ("ingest", "perception")}
    splits = store.read_index(inputs["ingest"], stage="ingest")
    for kind, drives in {
        "pseudo": splits,
        "lidar": splits if load(Ingest, params).lidar else {},
    }.items():
        work = partial(cloud.clouds_drive, kind=kind, settings=settings)
        with stage_folder(f"clouds@{kind}", out / kind, drives, params=params) as folder:
            make_drives(
                folder,
                file_jobs(drives, inputs, work),
                settings,
                "{frames} frames, {points} points",
            )
    return out


if __name__ == "__main__":
    console.run(main)
