"""Doubts about the labels of a run, by the summaries of
:func:`pipeline.labels.source.labels_drive`.
"""

from collections.abc import Iterator, Mapping

from pipeline.base import store
from pipeline.base.runner import Summary
from pipeline.labels.comparison import SHOWN

WINDOW = 8  # frames that a network sees, by default


def find_doubts(splits: Mapping[str, str], summaries: Mapping[str, Summary]) -> Iterator[str]:
    """Yield a line for each split with few labels or turns; on interpolated packets; and on
    implausible drives.

    `splits`: drive → split; `summaries`: drive → summary.
    """
    for split in dict.fromkeys(splits.values()):
        drives = store.drives_in(splits, split)
        frames = sum(summaries[drive]["frames"] for drive in drives)
        valid = sum(summaries[drive]["valid"] for drive in drives)
        turning = sum(summaries[drive]["turning"] for drive in drives)
        fix = "Add drives, or cut a recording otherwise: steer import --split 60,30,10"
        if valid < WINDOW:
            yield (
                f"doubt: {valid} of {frames} frames of {', '.join(drives)} have a label: the car "
                f"stands? {fix}"
            )
        elif turning < SHOWN:
            yield (
                f"doubt: {turning} of {frames} frames of split {split} turn, too few to tell "
                f"models apart. {fix}"
            )
    if count := sum(summary["interpolated"] for summary in summaries.values()):
        yield (
            f"{count} oxts packets are interpolated, not measured: they are no targets, and paths "
            "ahead end there"
        )
    if suspect := [drive for drive, summary in summaries.items() if summary["sideways"]]:
        names = ", ".join(suspect)
        yield (
            f"implausible labels: oxts has the car sliding sideways in {names}. Remove them from "
            "ingest.drives"
        )
