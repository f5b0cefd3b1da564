"""neurons.json: a wired network's synapses, and what its neurons do about the sharpest bend of a test drive."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base import store
from pipeline.train import frames
from pipeline.train.predict import Trained
from pipeline.train.windows import Drive

ABOUT = 25  # frames before and after the sharpest


def write(path: Path, model: Trained, drives: Sequence[Drive]) -> None:
    """Write `wiring` (:attr:`Trained.wiring`), `drive`, and of F frames `frame`, `steering_rad`, `activity` [F,U].

    Empty of a network without wiring, or if no drive has a window.
    """
    drive = max(drives, key=lambda drive: _sharpest(drive, model.window)[1], default=None)
    wiring = model.wiring
    if wiring is None or drive is None or (row := _sharpest(drive, model.window)[0]) < 0:
        store.write_json(path, {})
        return
    start, stop = next((start, stop) for start, stop in drive.runs if start <= row < stop)
    rows = slice(max(row - ABOUT, start + model.window - 1), min(row + ABOUT + 1, stop))
    with frames.open_graphs(drive.graphs) as graphs:
        activity = model.activity(graphs, rows.start, rows.stop)
    steering = drive.steering_rad[rows]
    store.write_json(path, {
        "wiring": wiring,
        "drive": drive.name,
        "frame": drive.frame[rows].tolist(),
        "steering_rad": [None if np.isnan(angle) else round(float(angle), 6) for angle in steering],
        "activity": [[round(float(value), 5) for value in of_frame] for of_frame in activity],
    })  # fmt: skip


def _sharpest(drive: Drive, window: int) -> tuple[int, float]:
    """Return the row where a whole window ends and the drive bends most, and the angle; -1 if there is none."""
    ends = np.zeros(len(drive.frame), bool)
    for start, stop in drive.runs:
        ends[start + window - 1 : stop] = True
    bend = np.where(drive.valid & ends, np.abs(np.nan_to_num(drive.steering_rad)), -1.0)
    row = int(bend.argmax()) if len(bend) else -1
    return (row, float(bend[row])) if row >= 0 and bend[row] >= 0 else (-1, -1.0)
