"""Stage sample: render the embedded sample, so that everything runs without KITTI.

The sample is a procedural world in KITTI raw's layout.
"""

from functools import partial
from pathlib import Path

from pipeline.jobs import console
from pipeline.jobs.outputs import stage_folder
from pipeline.jobs.runner import Job, make_drives

from pipeline.base.params import load_section
from pipeline.encoder.settings import Encoder
from pipeline.ingest.settings import Ingest
from pipeline.sample.render import render_drive
from pipeline.sample.rig import make_rig, write_calibration
from pipeline.sample.settings import Sample


def main(out: Path = Path("data/sample"), params: Path = Path("params.yaml")) -> Path:
    """Render the drives of section ingest that belong to the sample. Return the stage's folder."""
    settings = load_section(Sample, params)
    ingest = load_section(Ingest, params)
    encoder = load_section(Encoder, params)
    scan_rays = settings.scan_rays if ingest.lidar else None

    jobs = []
    # The longest drives start first, so that all processes end at about the same time.
    counts = settings.frames if ingest.source == "sample" else {}
    for split, frames in sorted(counts.items(), key=lambda item: -item[1]):
        # Ground truth is rendered only for its readers: stage scores for validation and test
        # drives, and a fit of the encoder for training drives.
        truth = split != "train" or encoder.epochs > 0
        for drive in getattr(ingest.drives, split):
            work = partial(
                render_drive,
                settings=settings,
                lidar=ingest.lidar,
                drive=drive,
                frames=frames,
                truth=truth,
            )
            target = f"{drive[:10]}/{drive}_sync"
            jobs.append(Job(drive, target, [f"{frames} {truth} {scan_rays}"], work))
    if not jobs:
        print("nothing to render: ingest.drives has no drive of the sample")

    with stage_folder("sample", out, params=params) as folder:
        key = settings.model_dump(include={"image_size", "seed"})
        make_drives(folder, jobs, key, log_format="{frames} frames, {metres} m")
        for date in {job.drive[:10] for job in jobs}:
            write_calibration(make_rig(settings.image_size, date), folder.new / date)
    return out


if __name__ == "__main__":
    console.run(main)
