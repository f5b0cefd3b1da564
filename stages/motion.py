"""Stage motion: measure the car's motion from the images, and write data/motion/<drive>.h5."""

from collections.abc import Mapping
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.outputs import stage_folder
from pipeline.base.runner import Summary, file_jobs, make_drives
from pipeline.motion.doubts import check_unit, find_doubts
from pipeline.motion.motion_file import measure_drive

# Least share of frames in which the road must be found. If it is found in fewer, the scale of the
# motion, and so the speed, is uncertain.
MIN_ROAD = 0.5


def main(data: Path = Path("data"), params: Path = Path("params.yaml")) -> Path:
    """Measure each drive's motion from images and depth. Return the output folder.

    The stage has no settings. `params` is an option of each stage.
    """
    inputs = {name: data / name for name in ("ingest", "perception")}
    out = data / "motion"
    splits = store.read_index(inputs["perception"], stage="perception")
    jobs = file_jobs(splits, inputs, measure_drive)
    with stage_folder("motion", out, splits, params=params) as folder:
        summaries = make_drives(folder, jobs, {}, "{frames} frames, {valid} measured")
        check_unit(summaries)
    print_doubts(summaries)
    return out


def print_doubts(summaries: Mapping[str, Summary]) -> None:
    """Print doubts about the measured motion.

    `summaries` maps drives to summaries by :func:`measure_drive`.
    """
    # Most drives have the same doubts, so each kind of doubt is printed once, with its first drive.
    doubts = dict[str, dict[str, str]]()
    for drive, summary in summaries.items():
        for kind, text in find_doubts(summary):
            doubts.setdefault(kind, {})[drive] = text
    for texts in doubts.values():
        drive = next(iter(texts))
        print(f"doubt: {drive} ({len(texts)} of {len(summaries)} drives): {texts[drive]}")

    # The camera's height over the road gives the scale of the motion.
    unscaled = [drive for drive, summary in summaries.items() if not summary["scaled"]]
    if unscaled:
        print(
            f"speed may be off by 20 %: no camera height in {', '.join(unscaled)}. "
            "Pass steer import --camera-height"
        )

    frames = sum(summary["frames"] for summary in summaries.values())
    road_frames = sum(summary["road_frames"] for summary in summaries.values())
    if frames and road_frames < MIN_ROAD * frames:
        print(
            f"the road was found in only {road_frames / frames:.0%} of the frames, so the speed is "
            "uncertain: models with motion: visual need base: none"
        )


if __name__ == "__main__":
    console.run(main)
