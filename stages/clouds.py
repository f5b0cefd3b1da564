"""Stage clouds: lift images and scans into semantic point clouds, data/clouds/{pseudo,lidar}/<drive>.h5."""

from functools import partial
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.params import load
from pipeline.base.runner import make_files
from pipeline.graphs import cloud
from pipeline.settings.clouds import Clouds
from pipeline.settings.ingest import Ingest


def main(
    ingest: Path = Path("data/ingest"),
    perception: Path = Path("data/perception"),
    out: Path = Path("data/clouds"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Back-project depth with K⁻¹ (paper eq. 6, 7) and transform LiDAR scans into the camera frame.

    Returns the output folder, which holds the folders pseudo and lidar; lidar has no drives without ingest.lidar.
    """
    settings = load(Clouds, params)
    splits = store.read_index(ingest, stage="ingest")
    inputs, text = {"ingest": ingest, "perception": perception}, "{frames} frames, {points} points"
    for kind, drives in {"pseudo": splits, "lidar": splits if load(Ingest, params).lidar else {}}.items():
        work = partial(cloud.clouds_drive, kind=kind, settings=settings)
        make_files(f"clouds@{kind}", out / kind, drives, inputs, work, settings, text)
    return out


if __name__ == "__main__":
    console.run(main)
