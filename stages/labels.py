"""Compute steering labels from the source that params.yaml names, and statistics of their plausibility."""

from functools import partial
from pathlib import Path

import numpy as np

from pipeline.base import console, store
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.base.runner import Summary, file_jobs, make_drives
from pipeline.kitti.oxts import VL, interpolated, make_rows
from pipeline.labels import ahead, comparison, label, sources
from pipeline.settings.labels import Labels

# Cars do not slide sideways: vl stays below 0.4 m/s in KITTI. Above this limit, heading or GNSS velocity is wrong, and
# the label with it: 2011_09_26_drive_0093 has 14 m/s to the left and then 11 m/s backwards.
SIDEWAYS_MPS = 1.0


def main(
    ingest: Path = Path("data/ingest"),
    motion: Path = Path("data/motion"),
    out: Path = Path("data/labels"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Compute each frame's steering angle (paper section 4.1), path ahead and their validity. Returns the folder.

    Recorded labels are first compared with measured motion. Raises InputError if their sign or unit is wrong.
    """
    settings = load(Labels, params)
    splits = store.read_index(ingest, stage="ingest")
    # Not with test drives: a lag fitted to them would align the truth with odometry.
    drives, car = store.drives_in(splits, "train", "val"), label.Car(settings.wheelbase_m, settings.min_speed_mps)
    for line in comparison.check(settings.source, comparison.read(settings.source, drives, ingest, motion, car)):
        print(line, flush=True)
    inputs = {"ingest": ingest} | ({} if settings.source == "oxts" else {"motion": motion})
    jobs = file_jobs(splits, inputs, partial(_label, settings=settings))
    text = "{frames} frames, {valid} valid, {turning} turning, {interpolated} interpolated"
    with stage_folder("labels", out) as folder:
        # One worker, as this is less work than starting a process.
        summaries = make_drives(folder, jobs, settings, text, workers=1)
        store.write_index(folder.new, splits)
    if count := sum(summary["interpolated"] for summary in summaries.values()):
        print(f"{count} oxts packets are interpolated, not measured: they are no targets, and paths ahead end there")
    suspect = [drive for drive, summary in summaries.items() if summary["sideways"]]
    if suspect:
        print(f"implausible labels, oxts has the car sliding sideways: {', '.join(suspect)}")
    return out


def _label(path: Path, ingest: Path, motion: Path | None = None, *, settings: Labels) -> Summary:
    """Write one drive's labels; count frames: all, valid, in bends, implausible, and interpolated."""
    with store.DriveReader(ingest, stage="ingest") as raw:
        drive, frame, time_s = raw.drive, raw.frame, raw.time_s
        labels = sources.read(settings.source, raw, motion, label.Car(settings.wheelbase_m, settings.min_speed_mps))
        packets = raw["oxts"] if settings.source != "visual" and "oxts" in raw else make_rows(len(frame))
    with store.DriveWriter(path, stage="labels", drive=drive, params={"labels": settings.model_dump()}) as file:
        label.write(file, frame, time_s, labels, settings.wheelbase_m)
        if settings.ahead_m:
            curvature_1pm, valid = ahead.path_ahead(frame, time_s, labels, settings.ahead_m, settings.max_stand_s)
            file.put("ahead_1pm", curvature_1pm, "1/m, left positive")
            file.put("ahead_valid", valid.astype(np.uint8))
    turning = labels.valid & (np.abs(labels.steering_rad) > comparison.TURNING_RAD)
    guessed = interpolated(packets)
    sideways = (np.abs(packets[:, VL]) > SIDEWAYS_MPS) & ~guessed
    counts = {"frames": np.ones(len(frame)), "valid": labels.valid, "turning": turning}
    counts |= {"sideways": sideways, "interpolated": guessed}
    return {name: int(mask.sum()) for name, mask in counts.items()}


if __name__ == "__main__":
    console.run(main)
