"""Find doubts about the labels of a run in the summaries of its drives."""

from collections.abc import Iterator, Mapping

from pipeline.base import store
from pipeline.base.runner import Summary
from pipeline.labels.comparison import TURNING_FRAMES

# Default number of frames in the input of a network.
WINDOW = 8


def find_doubts(splits: Mapping[str, str], summaries: Mapping[str, Summary]) -> Iterator[str]:
    """Yield messages about splits with few labels or turns, and about poorly recorded drives.

    `splits` is drive → split. `summaries` is drive → counts of frames, as
    :func:`pipeline.labels.source.labels_drive` returns them.
    """
    for split in dict.fromkeys(splits.values()):
        drives = store.drives_in(splits, split)
        frames = sum(summaries[drive]["frames"] for drive in drives)
        valid = sum(summaries[drive]["valid"] for drive in drives)
        turning = sum(summaries[drive]["turning"] for drive in drives)
        fix = "Add drives, or cut a recording otherwise: steer import --split 60,30,10"
        if valid < WINDOW:
            names = ", ".join(drives)
            text = f"{valid} of {frames} frames of {names} have a label: the car stands?"
            yield f"doubt: {text} {fix}"
        elif turning < TURNING_FRAMES:
            text = f"{turning} of {frames} frames of split {split} turn"
            yield f"doubt: {text}, too few to tell models apart. {fix}"

    interpolated = sum(summary["interpolated"] for summary in summaries.values())
    if interpolated:
        text = f"{interpolated} oxts packets are interpolated, not measured: they are no targets"
        yield f"{text}, and paths ahead end there"
    sideways = [drive for drive, summary in summaries.items() if summary["sideways"]]
    if sideways:
        text = f"oxts has the car sliding sideways in {', '.join(sideways)}"
        yield f"implausible labels: {text}. Remove them from ingest.drives"
