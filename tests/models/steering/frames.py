"""Small irregular frames of each kind, and their concatenation, without the code under test."""

import numpy as np

from models.steering.core.batch import Batch, from_arrays
from pipeline.graphs.graph import levels
from pipeline.graphs.graph_file import Arrays

# Array of row numbers → the array whose rows it counts.
REFERS_TO = {
    "indices": "xyz",
    "centres_1": "xyz",
    "neighbours_1": "xyz",
    "centres_2": "centres_1",
    "neighbours_2": "centres_1",
}
# Array → the array with the first row of each frame.
POINTERS = {
    "xyz": "ptr",
    "image": "ptr",
    "indices": "indices_ptr",
    "centres_1": "centres_1_ptr",
    "centres_2": "centres_2_ptr",
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


def sets(count: int, seed: int = 0) -> Arrays:
    """Return a frame with two levels of neighbourhoods."""
    arrays = points(count, seed)
    made = levels(arrays["xyz"], [(12, 8.0, 5), (4, 16.0, 6)], np.random.default_rng(seed))
    for number, (centres, neighbours) in enumerate(made, start=1):
        arrays |= {f"centres_{number}": centres, f"neighbours_{number}": neighbours}
    return arrays


def image(count: int, seed: int = 0) -> Arrays:
    """Return a random image, whatever the `count` of points."""
    return {"image": np.random.default_rng(seed).integers(0, 256, (1, 33, 50, 3), np.uint8)}


FRAME = {"graph": graph, "pointnet2": sets, "image": image}
CONTENTS = {"graph": {}, "pointnet2": {"levels": 2}, "image": {"image_size": (33, 50)}}


def concatenated(frames: list[Arrays]) -> Arrays:
    """Return the arrays of frames, whose row numbers count from 0 in each, and their pointers."""
    batch = {}
    for name in frames[0]:
        rows = []
        first = 0  # row of the frame in the batch
        for frame in frames:
            if name in REFERS_TO:
                rows.append(frame[name] + first)
                first += len(frame[REFERS_TO[name]])
            else:
                rows.append(frame[name])
        batch[name] = np.concatenate(rows)
        if name in POINTERS:
            lengths = [len(frame[name]) for frame in frames]
            batch[POINTERS[name]] = np.cumsum([0, *lengths])
    return batch


def join(frames: list[Arrays], device: str = "cpu") -> Batch:
    """Return frames as a batch."""
    return from_arrays(concatenated(frames), device)


def batch(counts: list[int], kind: str = "graph") -> Batch:
    """Return a batch of frames with these numbers of points."""
    return join([FRAME[kind](count, seed) for seed, count in enumerate(counts)])


def permuted(frame: Arrays, seed: int = 0) -> Arrays:
    """Return the same frame with its points, centres and neighbours in another order."""
    if "image" in frame:
        return frame
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(frame["xyz"]))
    place = np.argsort(order)  # new row of each point
    result = {"xyz": frame["xyz"][order], "cls": frame["cls"][order]}
    if "degree" in frame:
        neighbours = np.split(frame["indices"], np.cumsum(frame["degree"])[:-1])
        result["degree"] = frame["degree"][order]
        result["indices"] = np.concatenate([place[neighbours[node]] for node in order])
    level = 1
    while f"centres_{level}" in frame:
        centres = frame[f"centres_{level}"]
        neighbours = frame[f"neighbours_{level}"]
        turn = rng.permutation(len(centres))
        result[f"centres_{level}"] = place[centres[turn]]
        result[f"neighbours_{level}"] = place[neighbours[turn]][:, ::-1].copy()
        place = np.argsort(turn)
        level += 1
    return result
