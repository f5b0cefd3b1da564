"""Stage labels: steering angles from the source that params.yaml names, data/labels/<drive>.h5."""

from functools import partial
from pathlib import Path

from pipeline.jobs import console
from pipeline.jobs.outputs import stage_folder
from pipeline.jobs.runner import file_jobs, make_drives

from pipeline.base import store
from pipeline.base.params import load_section
from pipeline.labels.settings import Labels
from pipeline.labels.source import labels_drive


def main(data: Path = Path("data"), params: Path = Path("params.yaml")) -> Path:
    """Compute each frame's steering angle (paper section 4.1), path ahead and their validity.

    Returns the folder. data/motion is needed only if it is the source of the labels.
    """
    settings = load_section(Labels, params)
    out = data / "labels"
    inputs = {"ingest": data / "ingest"}
    if settings.source == "motion":
        inputs["motion"] = data / "motion"
    splits = store.read_index(inputs["ingest"], stage="ingest")
    with stage_folder("labels", out, splits, params=params) as folder:
        jobs = file_jobs(splits, inputs, partial(labels_drive, settings=settings))
        # This process makes all labels, which takes less time than starting another one.
        make_drives(folder, jobs, settings, log_format="{frames} frames, {valid} valid", workers=1)
    return out


if __name__ == "__main__":
    console.run(main)
