"""Which of a model's networks have something to be judged by."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.train import windows
from pipeline.train.runs import Fold


def judged(folds: Sequence[Fold], graphs: Path, labels: Path, line: Mapping[str, Any]) -> list[Fold]:
    """Return the folds whose test drives can be judged, found out before anything is trained; say which cannot.

    A drive that is too short, or straight throughout, still teaches the networks of other folds.

    Args:
        graphs: folder of the variant.
        line: a model's line, as resolved.
    Raises:
        InputError: none is left; or as :func:`windows.read_drive`.
    """
    kept, faults = [], []
    for fold in folds:
        drives = [windows.read_drive(graphs, labels, name, line["horizon"], line["motion"]) for name in fold.test]
        if what := windows.fault(drives, line["window"]):
            faults.append(what)
        else:
            kept.append(fold)
    if not kept:
        raise InputError(faults[0])
    for what in faults:
        print(f"not judged: {what}", flush=True)
    return kept
