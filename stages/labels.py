"""Compute steering labels from the source that params.yaml names, and statistics of their plausibility."""

from functools import partial
from pathlib import Path

import numpy as np

from pipeline.base import console, store
from pipeline.base.outputs import stage_folder
from pipeline.base.params import SPLITS, load
from pipeline.base.runner import Job, Summary, make_drives
from pipeline.kitti.oxts import VL
from pipeline.labels import ahead, label, sources
from pipeline.settings.labels import Labels

FEW = 0.02  # share of frames that move, or turn, below which a split says little about errors


def main(
    ingest: Path = Path("data/ingest"),
    motion: Path = Path("data/motion"),
    out: Path = Path("data/labels"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Compute the steering angle of each frame (paper section 4.1), the path ahead, and where both are valid.

    Returns the stage's folder.
    """
    settings = load(Labels, params)
    splits = store.read_index(ingest, stage="ingest")
    jobs = []
    for drive in splits:
        inputs = [folder / f"{drive}.h5" for folder in ((ingest,) if settings.source == "oxts" else (ingest, motion))]
        work = partial(_label, ingest=inputs[0], motion=[*inputs, None][1], settings=settings)
        jobs.append(Job(drive, f"{drive}.h5", inputs, work))
    with stage_folder("labels", out) as folder:
        # One worker, as this is less work than starting a process.
        summaries = make_drives(folder, jobs, settings, _describe, workers=1)
        store.write_json(folder.new / "summary.json", summaries)
        store.write_index(folder.new, splits)
    for split in SPLITS:
        of_split = [summaries[drive] for drive in store.drives_in(splits, split)]
        frames, valid, turning = (sum(summary[key] for summary in of_split) for key in ("frames", "valid", "turning"))
        if of_split and min(valid / max(frames, 1), turning / max(valid, 1)) < FEW:
            print(f"{split}: the car moves in {valid} of {frames} frames and turns in {turning}, too few to test on")
    suspect = [drive for drive, summary in summaries.items() if summary["sideways"]]
    if suspect:
        print(f"implausible labels, oxts has the car sliding sideways: {', '.join(suspect)}")
    return out


def _label(path: Path, *, ingest: Path, motion: Path | None, settings: Labels) -> Summary:
    """Write one drive's labels and return their plausibility statistics."""
    with store.DriveReader(ingest, stage="ingest") as raw:
        drive, frame, time_s = raw.drive, raw.frame, raw.time_s
        labels = sources.read(settings.source, raw, motion, label.Car(settings.wheelbase_m, settings.min_speed_mps))
        sideways_mps = raw["oxts"][:, VL] if settings.source == "oxts" else np.zeros(len(frame))
    with store.DriveWriter(path, stage="labels", drive=drive, params={"labels": settings.model_dump()}) as file:
        label.write(file, frame, time_s, labels, settings.wheelbase_m)
        if settings.ahead_m:
            ahead.write(file, ahead.path_ahead(frame, time_s, labels, settings.ahead_m, settings.max_stand_s))
    return label.plausibility(labels, sideways_mps)


def _describe(summary: Summary) -> str:
    """Return the text for a drive's line in the log."""
    text = "{frames} frames, {valid} valid, {turning} turning"
    if summary["valid"]:
        text += ", |steering| mean {mean_abs_steering_rad:.4f} max {max_abs_steering_rad:.3f} rad"
        text += ", zero-MSE {zero_mse_rad2:.5f} rad²"
    for kind in ("reversing", "sideways"):
        text += f", {{{kind}}} {kind}" if summary[kind] else ""
    return text.format_map(summary)


if __name__ == "__main__":
    console.run(main)
