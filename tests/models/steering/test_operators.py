"""Operators of a training step on a GPU, counted on torch's device without data: each is a launch."""

from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from models.steering.spatial import gnn
from tests.models.steering import frames
from tests.models.steering.test_steering_net import entry

WINDOW = 8


class Counter(TorchDispatchMode):
    """Counts operators but views, which launch nothing."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.count += not func.is_view
        return func(*args, **(kwargs or {}))


def operators(count: int) -> int:
    """Return the operators of forward and backward of sa-gnn-ncp with `count` frames of 20 points."""
    net = entry(equivariant=True, window=WINDOW).build("graph").to("meta")
    batch = frames.join([frames.graph(20, seed) for seed in range(count)], "meta")
    windows = torch.from_numpy(np.lib.stride_tricks.sliding_window_view(np.arange(count), WINDOW).copy())
    with Counter() as counter:
        net(batch, windows.to("meta"), torch.full(windows.shape, 0.1, device="meta"), pairs=True).sum().backward()
    return counter.count


def test_a_training_step_has_as_many_operators_for_any_number_of_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pooling or encoding frame by frame would add at least two for each; the recursion has six steps a frame."""
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())  # this device has none, nor sparse matrices
    monkeypatch.setattr(gnn, "normalised_adjacency", lambda degree, *_: torch.empty(2 * degree.shape, device="meta"))
    few, many = operators(10), operators(40)
    assert few == many < 550
