"""Stage labels: steering angles from the source that params.yaml names, data/labels/<drive>.h5."""

from functools import partial
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.base.runner import file_jobs, make_drives
from pipeline.labels import comparison
from pipeline.labels.doubts import find_doubts
from pipeline.labels.label import Car
from pipeline.labels.settings import Labels
from pipeline.labels.source import labels_drive


def main(data: Path = Path("data"), params: Path = Path("params.yaml")) -> Path:
    """Compute each frame's steering angle (paper section 4.1), path ahead and their validity.

    Recorded labels are first compared with measured motion. Returns the folder. Raises InputError
    if the sign or the unit of recorded labels is wrong.
    """
    settings = load(Labels, params)
    ingest = data / "ingest"
    motion = data / "motion"
    out = data / "labels"
    splits = store.read_index(ingest, stage="ingest")
    with stage_folder("labels", out, splits, params=params) as folder:
        # Test drives are not compared, as a lag that is fitted to them would align the truth with
        # odometry.
        drives = store.drives_in(splits, "train", "val") or [*splits]
        car = Car(settings.wheelbase_m, settings.min_speed_mps)
        pairs = comparison.read_pairs(settings.source, drives, ingest, motion, car)
        for line in comparison.check_recorded(settings.source, pairs):
            print(line, flush=True)

        inputs = {"ingest": ingest}
        if motion.is_dir():
            inputs["motion"] = motion
        jobs = file_jobs(splits, inputs, partial(labels_drive, settings=settings))
        log_format = (
            "{frames} frames, {valid} valid, {turning} turning, {interpolated} interpolated"
        )
        # This process makes all labels, which takes less time than starting another one.
        summaries = make_drives(folder, jobs, settings, log_format, workers=1)
    for line in find_doubts(splits, summaries):
        print(line)
    return out


if __name__ == "__main__":
    console.run(main)
