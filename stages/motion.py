"""Stage motion: measure the car's motion since the previous frame, without oxts, data/motion/<drive>.h5."""

from pathlib import Path

from pipeline.base import console, store
from pipeline.base.runner import make_files
from pipeline.motion.drive import measure_drive
from pipeline.motion.still import warnings

MIN_ROAD = 0.5  # share of frames with a road, below which the scale is called uncertain


def main(
    ingest: Path = Path("data/ingest"), perception: Path = Path("data/perception"), out: Path = Path("data/motion")
) -> Path:
    """Measure each drive's motion from images and depth. Returns the output folder."""
    splits = store.read_index(perception, stage="perception")
    inputs, text = {"ingest": ingest, "perception": perception}, "{frames} frames, {valid} measured"
    made = make_files("motion", out, splits, inputs, measure_drive, {}, text)
    for drive, summary in made.items():
        for text in warnings(summary["still"]):
            print(f"{drive}: {text}")
    frames, road = (sum(summary[name] for summary in made.values()) for name in ("frames", "road_frames"))
    if frames and road < MIN_ROAD * frames:
        fix = "Set base: none in models that read motion"
        print(f"the road was found in only {road / frames:.0%} of the frames, so the speed is uncertain. {fix}")
    return out


if __name__ == "__main__":
    console.run(main)
