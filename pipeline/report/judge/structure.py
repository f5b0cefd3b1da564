"""structure.json: the graph that a model saw in one frame of each test drive, for people to turn around."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.train import frames
from pipeline.train.windows import Drive

MOST_POINTS = 5000  # a frame with more is a burden to a browser, and a black cloud to the eye


def write(path: Path, drives: Sequence[Drive]) -> None:
    """Write drive → frame, xyz_m [[x,y,z],…], cls [P], edges [[a,b],…] with a < b; of drives with kNN graphs.

    The frame is the one where the drive bends most. Of one with more than MOST_POINTS points, so many of the nearest.
    """
    shown = {}
    for drive in drives:
        with frames.open_graphs(drive.graphs) as graphs:
            if graphs.contents["kind"] == "graph" and len(drive.frame):
                shown[drive.name] = _structure(graphs, drive, _sharpest(drive))
    store.write_json(path, shown)


def _sharpest(drive: Drive) -> int:
    bend = np.where(drive.valid, np.abs(np.nan_to_num(drive.steering_rad)), -1.0)
    return int(bend.argmax())


def _structure(graphs: frames.Graphs, drive: Drive, row: int) -> dict[str, Any]:
    arrays = graphs.read(row, row + 1)
    xyz, cls, degree, indices = (arrays[name] for name in ("xyz", "cls", "degree", "indices"))
    near = np.sort(np.argsort(np.linalg.norm(xyz, axis=1), kind="stable")[:MOST_POINTS])
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
