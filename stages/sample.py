"""Render the embedded sample, a procedural world in KITTI raw's layout, so that everything runs without KITTI."""

from functools import partial
from pathlib import Path

from pipeline.base import console
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.base.runner import Job, make_drives
from pipeline.kitti.raw import find_drives
from pipeline.sample.drive import render_drive
from pipeline.sample.rig import make_rig, write_calibration
from pipeline.settings.ingest import Ingest
from pipeline.settings.sample import Sample


def main(
    out: Path = Path("data/sample"),
    params: Path = Path("params.yaml"),
    raw: Path = Path("data/raw"),
    workers: int | None = None,
) -> Path:
    """Render the drives of section ingest that belong to the sample; none with ingest.source: kitti.

    Returns the stage's folder. Raises InputError if `raw` lacks a drive of section ingest, which stage `ingest` would
    report only after minutes of rendering.
    """
    settings, ingest = load(Sample, params), load(Ingest, params)
    sources, splits = ingest.sources(), ingest.drives.splits()
    frames = {
        drive: count
        for split, count in settings.frames.items()
        for drive in getattr(ingest.drives, split)
        if sources[drive] == "sample"
    }
    if not frames:
        print(f"nothing to render: ingest.drives has no drive of the sample (ingest.source: {ingest.source})")
    elif real := [drive for drive in splits if sources[drive] == "kitti"]:
        find_drives(raw, real)
    render = partial(render_drive, size=settings.image_size, scan_rays=settings.scan_rays, seed=settings.seed)
    jobs = [
        Job(drive, f"{drive[:10]}/{drive}_sync", [str(count)], partial(render, drive=drive, frames=count))
        for drive, count in sorted(frames.items(), key=lambda item: -item[1])  # the longest first
    ]
    text = "{frames} frames, {metres} m"
    with stage_folder("sample", out) as folder:
        make_drives(folder, jobs, settings.model_dump(exclude={"frames"}), text.format_map, workers)
        for date in {drive[:10] for drive in frames}:
            write_calibration(make_rig(settings.image_size, date), folder.new / date)
    return out


if __name__ == "__main__":
    console.run(main)
