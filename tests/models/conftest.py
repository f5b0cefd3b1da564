"""Small graphs that are as irregular as real ones: unequal frames, an empty one, lonely nodes."""

from collections.abc import Callable

import pytest
import torch

from models.frames import GraphBatch

MakeBatch = Callable[..., GraphBatch]


@pytest.fixture
def make_batch() -> MakeBatch:
    """make_batch([points per frame], seed=0) → random symmetric graphs without edges between frames, xyz in float64."""

    def make(counts: list[int], seed: int = 0) -> GraphBatch:
        generator = torch.Generator().manual_seed(seed)
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
def line() -> dict[str, object]:
    """A small model's line of params.yaml."""
    wiring = {
        "inter": 8,
        "command": 5,
        "sensory_fanout": 3,
        "inter_fanout": 2,
        "recurrent_command_synapses": 4,
        "motor_fanin": 3,
    }
    return {
        "input": "semantic",
        "spatial": "gnn",
        "temporal": "ncp",
        "cell": "ltc",
        "window": 4,
        "semantics": 1.0,
        "alpha": 0.0,
        "layers": [8, 12],
        "features": 6,
        "units": 7,
        "wiring": {**wiring, "seed": 0},
    }
