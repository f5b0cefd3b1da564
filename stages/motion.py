"""Stage motion: measure the car's motion since the previous frame, without oxts, data/motion/<drive>.h5."""

from functools import partial
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.outputs import stage_folder
from pipeline.base.runner import Job, make_drives
from pipeline.motion.drive import measure_drive

MIN_ROAD = 0.5  # share of frames with a road, below which the scale is called uncertain


def main(
    ingest: Path = Path("data/ingest"),
    perception: Path = Path("data/perception"),
    out: Path = Path("data/motion"),
    workers: int | None = None,
) -> Path:
    """Measure each drive's motion from images and depth. Returns the output folder."""
    splits = store.read_index(perception, stage="perception")
    jobs = []
    for drive in splits:
        inputs = ingest / f"{drive}.h5", perception / f"{drive}.h5"
        work = partial(measure_drive, ingest=inputs[0], perception=inputs[1])
        jobs.append(Job(drive, f"{drive}.h5", inputs, work))
    with stage_folder("motion", out) as folder:
        made = make_drives(folder, jobs, {}, "{frames} frames, {valid} measured".format_map, workers)
        store.write_index(folder.new, splits)
    without = [drive for drive, summary in made.items() if not summary["valid"]]
    if without:
        print(f"no motion measured in {', '.join(without)}")
    frames, road = (sum(summary[name] for summary in made.values()) for name in ("frames", "road_frames"))
    if frames and road < MIN_ROAD * frames:
        fix = "Set base: none in models that read motion"
        print(f"the road was found in only {road / frames:.0%} of the frames, so the speed is uncertain. {fix}")
    return out


if __name__ == "__main__":
    console.run(main)
