"""Drives and batches of the tests in this folder."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.graphs.graph_file import Arrays
from pipeline.train import windows
from pipeline.train.labelled_drive import read_drives
from tests import artefacts

DRIVES = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}


def read_batch(folder: Path, spans: Sequence[windows.Span]) -> Arrays:
    """Add visual motion to the drives in `folder`, and return one batch of windows of 8 frames."""
    for name in DRIVES:
        artefacts.add_motion(folder / f"graphs/semantic/{name}.h5", np.linspace(-0.3, 0.4, 12))
    drives = read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), 8, motion="visual")
    (batch,) = windows.batches(drives, [spans], 8)
    return batch
