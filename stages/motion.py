"""Stage motion: measure the car's motion since the previous frame, without oxts,
data/motion/<drive>.h5.
"""

from pathlib import Path

from pipeline.base import console, store
from pipeline.base.outputs import stage_folder
from pipeline.base.runner import file_jobs, make_drives
from pipeline.motion.doubts import check_unit, find_doubts
from pipeline.motion.motion_file import measure_drive

MIN_ROAD = 0.5  # share of frames with a road, below which the scale is called uncertain


def main(data: Path = Path("data")) -> Path:
    """Measure each drive's motion from images and depth. Returns the output folder."""
    inputs, out = {name: data / name for name in ("ingest", "perception")}, data / "motion"
    splits = store.read_index(inputs["perception"], stage="perception")
    jobs = file_jobs(splits, inputs, measure_drive)
    with stage_folder("motion", out, splits) as folder:
        made = make_drives(folder, jobs, {}, "{frames} frames, {valid} measured")
        check_unit(made)
    # One line for each kind of doubt: what is wrong with one drive is wrong with most.
    found = dict[str, dict[str, str]]()
    for drive, summary in made.items():
        for kind, text in find_doubts(summary):
            found.setdefault(kind, {})[drive] = text
    for texts in found.values():
        drive = next(iter(texts))
        print(f"doubt: {drive} ({len(texts)} of {len(made)} drives): {texts[drive]}")
    if unknown := [drive for drive, summary in made.items() if not summary["scaled"]]:
        print(
            f"speed may be off by 20 %: no camera height in {', '.join(unknown)}. Pass steer "
            "import --camera-height"
        )
    frames, road = (
        sum(summary[name] for summary in made.values()) for name in ("frames", "road_frames")
    )
    if frames and road < MIN_ROAD * frames:
        fix = "models with motion: visual need base: none"
        print(
            f"the road was found in only {road / frames:.0%} of the frames, so the speed is "
            f"uncertain: {fix}"
        )
    return out


if __name__ == "__main__":
    console.run(main)
