"""Write what a model computes where a test drive bends most: its graph and the states of its neurons, as JSON."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.train import frames
from pipeline.train.predict import Trained
from pipeline.train.windows import Drive

MAX_POINTS = 5000  # more points slow a browser down
MARGIN = 25  # frames before and after the sharpest bend


def write_graphs(path: Path, drives: Sequence[Drive]) -> None:
    """Write drive → frame, points, xyz_m [[x,y,z],…], cls [P], edges [[a,b],…] with a < b, for kNN graphs.

    Points beyond the nearest MAX_POINTS are left out; `points` counts all.
    """
    written = {}
    for drive in drives:
        with frames.open_graphs(drive.graphs) as graphs:
            if graphs.contents["kind"] == "graph" and len(drive.frame):
                row, _ = _sharpest(drive, np.ones(len(drive.frame), bool))
                written[drive.name] = _graph(graphs, drive, max(row, 0))
    store.write_json(path, written)


def _graph(graphs: frames.Graphs, drive: Drive, row: int) -> dict[str, Any]:
    arrays = graphs.read(row, row + 1)
    xyz, cls, degree, indices = (arrays[name] for name in ("xyz", "cls", "degree", "indices"))
    near = np.sort(np.argsort(np.linalg.norm(xyz, axis=1), kind="stable")[:MAX_POINTS])
    number = np.full(len(xyz), -1)
    number[near] = np.arange(len(near))
    edges = np.stack([number[np.repeat(np.arange(len(xyz)), degree)], number[indices.astype(np.int64)]], axis=1)
    edges = edges[(edges[:, 0] >= 0) & (edges[:, 0] < edges[:, 1])]
    return {
        "frame": int(drive.frame[row]),
        "points": len(xyz),
        "xyz_m": [[round(float(value), 3) for value in point] for point in xyz[near]],
        "cls": cls[near].tolist(),
        "edges": edges.tolist(),
    }


def write_neurons(path: Path, model: Trained, drives: Sequence[Drive]) -> None:
    """Write wiring (:attr:`Trained.wiring`), drive, and for F frames: frame, steering_rad and activity [F,U].

    An empty object for a network without wiring, or if no window is complete.
    """
    bends = [(drive, *_sharpest(drive, _window_ends(drive, model.window))) for drive in drives]
    drive, row, _ = max(bends, key=lambda bend: bend[2], default=(None, -1, -1.0))
    wiring = model.wiring
    if wiring is None or drive is None or row < 0:
        store.write_json(path, {})
        return
    start, stop = next((start, stop) for start, stop in drive.runs if start <= row < stop)
    rows = slice(max(row - MARGIN, start + model.window - 1), min(row + MARGIN + 1, stop))
    with frames.open_graphs(drive.graphs) as graphs:
        activity = model.activity(graphs, rows.start, rows.stop)
    content = {
        "wiring": wiring,
        "drive": drive.name,
        "frame": drive.frame[rows].tolist(),
        "steering_rad": [None if np.isnan(angle) else round(float(angle), 6) for angle in drive.steering_rad[rows]],
        "activity": [[round(float(value), 5) for value in states] for states in activity],
    }
    store.write_json(path, content)


def _sharpest(drive: Drive, allowed: np.ndarray) -> tuple[int, float]:
    """Return the row with the largest valid |steering| among `allowed` [G], and that angle in rad; -1, -1 if none."""
    bend = np.where(drive.valid & allowed, np.abs(np.nan_to_num(drive.steering_rad)), -1.0)
    row = int(bend.argmax()) if len(bend) else -1
    return (row, float(bend[row])) if row >= 0 and bend[row] >= 0 else (-1, -1.0)


def _window_ends(drive: Drive, window: int) -> np.ndarray:
    """Return the rows [G] at which a complete window ends, bool."""
    ends = np.zeros(len(drive.frame), bool)
    for start, stop in drive.runs:
        ends[start + window - 1 : stop] = True
    return ends
