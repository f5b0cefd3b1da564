"""Render the embedded sample, a procedural world in KITTI raw's layout, so that everything runs
without KITTI.
"""

from functools import partial
from pathlib import Path

from pipeline.base import console
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.base.runner import Job, make_drives
from pipeline.encoder.settings import Encoder
from pipeline.ingest.settings import Ingest
from pipeline.sample.render import render_drive
from pipeline.sample.rig import make_rig, write_calibration
from pipeline.sample.settings import Sample


def main(out: Path = Path("data/sample"), params: Path = Path("params.yaml")) -> Path:
    """Render the drives of section ingest that belong to the sample. Returns the stage's folder."""
    settings, ingest, encoder = load(Sample, params), load(Ingest, params), load(Encoder, params)
    scan_rays = settings.scan_rays if ingest.lidar else None
    render, jobs, sources = (
        partial(render_drive, settings=settings, lidar=ingest.lidar),
        [],
        ingest.datasets(),
    )
    # the longest first
    for split, frames in sorted(settings.frames.items(), key=lambda item: -item[1]):
        truth = split != "train" or encoder.epochs > 0  # which stages `scores` and `encoder` read
        for drive in getattr(ingest.drives, split):
            if sources[drive] == "sample":
                work = partial(render, drive=drive, frames=frames, truth=truth)
                jobs.append(
                    Job(
                        drive, f"{drive[:10]}/{drive}_sync", [f"{frames} {truth} {scan_rays}"], work
                    )
                )
    if not jobs:
        print("nothing to render: ingest.drives has no drive of the sample")
    with stage_folder("sample", out, params=params) as folder:
        make_drives(
            folder,
            jobs,
            settings.model_dump(include={"image_size", "seed"}),
            "{frames} frames, {metres} m",
        )
        for date in {job.drive[:10] for job in jobs}:
            write_calibration(make_rig(settings.image_size, date), folder.new / date)
    return out


if __name__ == "__main__":
    console.run(main)
