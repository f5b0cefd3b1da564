"""Small irregular frames of each kind, and their concatenation, without the code under test."""

from typing import Any

import numpy as np

from models.steering.core.batch import Batch, GraphBatch, from_arrays
from models.steering.core.options import NetworkOptions
from pipeline.graphs.graph_file import Arrays

# Array → the array with the first row of each frame.
POINTERS = {
    "xyz": "ptr",
    "image": "ptr",
    "indices": "indices_ptr",
}


def points(count: int, seed: int) -> Arrays:
    """Return xyz float64 [P,3] on a street, and cls with each seventh point void."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform([-10, -1, 0], [10, 2, 60], (count, 3))
    cls = rng.integers(0, 19, count)
    cls[::7] = 255
    return {"xyz": xyz, "cls": cls.astype(np.uint8)}


def graph(count: int, seed: int = 0) -> Arrays:
    """Return a frame with a random symmetric graph."""
    linked = np.random.default_rng(seed).random((count, count)) < 0.15
    linked = (linked | linked.T) & ~np.eye(count, dtype=bool)
    arrays = {
        "degree": linked.sum(1).astype(np.uint8),
        "indices": np.nonzero(linked)[1].astype(np.int32),
    }
    return points(count, seed) | arrays


def image(count: int, seed: int = 0) -> Arrays:
    """Return a random image, whatever the `count` of points."""
    return {"image": np.random.default_rng(seed).integers(0, 256, (1, 33, 50, 3), np.uint8)}


FRAME = {"graph": graph, "image": image}
CONTENTS = {"graph": {}, "image": {"image_size": (33, 50)}}


def concatenated(frames: list[Arrays]) -> Arrays:
    """Return the arrays of frames, whose row numbers count from 0 in each, and their pointers."""
    batch = {}
    for name in frames[0]:
        rows = []
        first = 0  # row of the frame in the batch
        for frame in frames:
            if name == "indices":
                rows.append(frame[name] + first)
                first += len(frame["xyz"])
            else:
                rows.append(frame[name])
        batch[name] = np.concatenate(rows)
        if name in POINTERS:
            lengths = [len(frame[name]) for frame in frames]
            batch[POINTERS[name]] = np.cumsum([0, *lengths])
    return batch


def join(frames: list[Arrays], device: str = "cpu", options: NetworkOptions | None = None) -> Batch:
    """Return frames as a batch, with what a network of these options prepares of each frame."""
    arrays: dict[str, Any] = concatenated(frames)
    if options and "xyz" in arrays:
        points = from_arrays(arrays)
        assert isinstance(points, GraphBatch)
        prepared = options.prepare(points)
        if prepared is not None:
            arrays["prepared"] = prepared
    return from_arrays(arrays, device)


def batch(counts: list[int], kind: str = "graph", options: NetworkOptions | None = None) -> Batch:
    """Return a batch of frames with these numbers of points."""
    return join([FRAME[kind](count, seed) for seed, count in enumerate(counts)], "cpu", options)
