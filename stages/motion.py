"""Stage motion: measure the car's motion from the images, and write data/motion/<drive>.h5."""

from pathlib import Path

from pipeline.jobs import console
from pipeline.jobs.outputs import stage_folder
from pipeline.jobs.runner import file_jobs, make_drives

from pipeline.base import store
from pipeline.motion.facts import check_unit, facts_lines
from pipeline.motion.measure import measure_drive


def main(data: Path = Path("data"), params: Path = Path("params.yaml")) -> Path:
    """Measure each drive's motion from images and depth. Return the output folder.

    The stage has no settings. `params` is an option of each stage.
    """
    inputs = {name: data / name for name in ("ingest", "perception")}
    out = data / "motion"
    splits = store.read_index(inputs["perception"], stage="perception")
    jobs = file_jobs(splits, inputs, measure_drive)
    with stage_folder("motion", out, splits, params=params) as folder:
        summaries = make_drives(folder, jobs, {}, log_format="{frames} frames, {valid} measured")
        check_unit(summaries)
    for line in facts_lines(summaries):
        print(line)
    return out


if __name__ == "__main__":
    console.run(main)
