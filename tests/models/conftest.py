"""Small irregular graphs: unequal frames, empty frames, nodes without neighbours."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from models.steering.core import options
from models.steering.core.batch import GraphBatch, SetBatch, from_arrays
from pipeline.graphs import graph_file, neighbourhoods

MakeBatch = Callable[..., GraphBatch]
MakeSets = Callable[..., SetBatch]
MakeLine = Callable[..., dict[str, object]]
REFERS_TO = {"indices": "xyz", "centres_1": "xyz", "neighbours_1": "xyz"}
REFERS_TO |= {"centres_2": "centres_1", "neighbours_2": "centres_1"}
POINTERS = {"xyz": "ptr", "centres_1": "centres_1_ptr", "centres_2": "centres_2_ptr"}


def join(frames: list[graph_file.Arrays]) -> graph_file.Arrays:
    """Return frames, with numbers that count from 0 in each, as the arrays of a batch."""
    batch = {}
    for name in frames[0]:
        lengths = [len(frame[REFERS_TO[name]]) if name in REFERS_TO else 0 for frame in frames]
        before = np.cumsum([0, *lengths[:-1]])
        parts = [frame[name] + first if first else frame[name] for frame, first in zip(frames, before, strict=True)]
        batch[name] = np.concatenate(parts)
        if name in POINTERS:
            batch[POINTERS[name]] = np.cumsum([0, *(len(frame[name]) for frame in frames)])
    return batch


@pytest.fixture
def make_batch() -> MakeBatch:
    """make_batch([points per frame]) → random symmetric graphs without edges between frames, xyz in float64."""

    def make(counts: list[int]) -> GraphBatch:
        generator = torch.Generator().manual_seed(0)
        nodes = sum(counts)
        ptr = torch.tensor([0, *counts]).cumsum(0)
        frame = torch.arange(len(counts)).repeat_interleave(torch.tensor(counts))
        linked = torch.rand(nodes, nodes, generator=generator) < 0.15
        linked = (linked | linked.T) & (frame[:, None] == frame) & ~torch.eye(nodes, dtype=torch.bool)
        xyz = torch.rand(nodes, 3, generator=generator, dtype=torch.float64) * torch.tensor([20, 3, 60]) - torch.tensor(
            [10, 1, 0]
        )
        cls = torch.randint(0, 19, (nodes,), generator=generator).to(torch.uint8)
        cls[::7] = 255
        return GraphBatch(xyz, cls, ptr, linked.sum(1).to(torch.uint8), linked.nonzero()[:, 1])

    return make


@pytest.fixture
def make_sets() -> MakeSets:
    """make_sets([points per frame], only=None) → two levels of neighbourhoods; `only`: this frame alone."""

    def frame(count: int, seed: int) -> graph_file.Arrays:
        rng = np.random.default_rng(seed)
        xyz = rng.uniform([-10, -1, 0], [10, 2, 30], (count, 3))
        cls = np.where(np.arange(count) % 7, rng.integers(0, 19, count), 255).astype(np.uint8)
        arrays = {"xyz": xyz, "cls": cls}
        for number, level in enumerate(neighbourhoods.levels(xyz, [(12, 8.0, 5), (4, 16.0, 6)], rng), start=1):
            arrays |= {f"centres_{number}": level.centres, f"neighbours_{number}": level.neighbours}
        return arrays

    def make(counts: list[int], only: int | None = None) -> SetBatch:
        parts = [frame(count, seed) for seed, count in enumerate(counts)]
        batch = from_arrays(join(parts if only is None else parts[only : only + 1]))
        assert isinstance(batch, SetBatch)
        return batch

    return make


SMALL: dict[str, object] = {
    "layers": [8, 12],
    "semantics": 1.0,
    "width": 0.125,
    "units": 7,
    "wiring": {
        **{"inter": 8, "command": 5, "sensory_fanout": 3, "inter_fanout": 2},
        **{"recurrent_command_synapses": 4, "motor_fanin": 3},
    },
}


@pytest.fixture
def make_line() -> MakeLine:
    """make_line(spatial="gnn", temporal="ncp", key=value, …) → a small model's entry of params.yaml."""

    def make(spatial: str = "gnn", temporal: str = "ncp", **changes: object) -> dict[str, object]:
        line = {"input": "semantic", "spatial": spatial, "temporal": temporal, "window": 4, "features": 8}
        known = {
            *options.load("spatial", spatial).model_fields,
            *options.load("temporal", temporal).model_fields,
        }
        return line | {"equivariant": False} | {key: SMALL[key] for key in SMALL if key in known} | changes

    return make
