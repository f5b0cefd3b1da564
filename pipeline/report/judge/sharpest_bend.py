"""Write the graph of the frame in which a test drive bends most, as JSON."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.train import frames
from pipeline.train.windows import Drive

MAX_POINTS = 5000  # more points slow a browser down


def write_graphs(path: Path, drives: Sequence[Drive]) -> None:
    """Write drive → frame, points, xyz_m [[x,y,z],…], cls [P], edges [[a,b],…] with a < b, for kNN graphs.

    Points beyond the nearest MAX_POINTS are left out; `points` counts all.
    """
    written = {}
    for drive in drives:
        with frames.open_graphs(drive.graphs) as graphs:
            if graphs.contents["kind"] == "graph" and len(drive.frame):
                bend = np.where(drive.valid, np.abs(np.nan_to_num(drive.steering_rad)), -1.0)
                written[drive.name] = _graph(graphs, drive, int(bend.argmax()))
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
