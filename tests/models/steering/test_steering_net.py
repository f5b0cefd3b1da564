"""Networks of each combination: shared frames, mirroring, motion, paths, launches."""

from typing import Any

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from models.steering.core.options import NetworkOptions, load
from models.steering.core.steering_net import EPSILON, FeatureScale, SteeringNet
from models.steering.spatial import gnn
from models.steering.temporal.ncp import CELLS
from pipeline.train.entry import Entry
from tests.models.steering import frames
from tests.models.steering.test_networks import NETWORKS, keys

TOLERANCE = {"rtol": 0, "atol": 1e-9}
WINDOWS = torch.tensor([[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]])
DT_S = (
    torch.rand(WINDOWS.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(2)) * 0.1
    + 0.05
)
MOTION = torch.rand(6, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
MOTION *= torch.tensor([0.2, 0.5, 20, 1])
# angle and yaw rate change sign, speed and valid do not
MIRROR = torch.tensor([-1.0, -1.0, 1.0, 1.0])
COUNTS = [20, 9, 30, 12, 0, 25]  # points per frame
SPATIAL = [name for name in NETWORKS if name != "blind"]  # blind has no input
WIRING = {"inter": 8, "command": 5, "sensory_fanout": 3, "inter_fanout": 2, "motor_fanin": 3}
SMALL = {"layers": [8, 12], "semantics": 1.0, "width": 0.125, "units": 7}
SMALL["wiring"] = WIRING | {"recurrent_command_synapses": 4}
each_cell = pytest.mark.parametrize("cell", ["lstm", *CELLS])


def entry(spatial: str = "gnn", cell: str = "ltc", **changes: Any) -> Entry:
    """Return a small model's entry; `cell`: lstm, or a cell of ncp."""
    temporal = {"temporal": "lstm"} if cell == "lstm" else {"temporal": "ncp", "cell": cell}
    known = {*options(spatial).model_fields, *load("temporal", temporal["temporal"]).model_fields}
    small = {key: value for key, value in SMALL.items() if key in known}
    general = {"input": "semantic", "window": 4, "features": 8}
    return Entry.model_validate(general | keys(spatial) | temporal | small | changes)


def options(spatial: str) -> type[NetworkOptions]:
    return load("spatial", keys(spatial)["spatial"])


def build(spatial: str = "gnn", cell: str = "ltc", outputs: int = 1, **changes: Any) -> SteeringNet:
    """Return a small network in evaluation mode, with the features' statistics of one step of
    training.
    """
    torch.manual_seed(0)
    kind = options(spatial).kind
    net = (
        entry(spatial, cell, **changes)
        .build(kind, **frames.CONTENTS[kind], outputs=outputs)
        .double()
    )
    net(batch(spatial), WINDOWS, DT_S, MOTION if net.motion else None)
    return net.eval()


def batch(spatial: str = "gnn") -> Any:
    return frames.batch(COUNTS, options(spatial).kind)


@each_cell
@pytest.mark.parametrize("spatial", SPATIAL)
def test_shared_frames_equal_naive_windows(spatial, cell):
    """Values and gradients: each window read and encoded for itself."""
    net, kind = build(spatial, cell), options(spatial).kind
    parts = [frames.FRAME[kind](count, seed) for seed, count in enumerate(COUNTS)]
    shared = net(frames.join(parts), WINDOWS, DT_S)
    own = torch.arange(4)[None]
    windows = [frames.join([parts[row] for row in window]) for window in WINDOWS.tolist()]
    naive = torch.cat([net(window, own, DT_S[w : w + 1]) for w, window in enumerate(windows)])
    torch.testing.assert_close(shared, naive, **TOLERANCE)
    gradients = [
        torch.autograd.grad(out.square().sum(), list(net.parameters())) for out in (shared, naive)
    ]
    torch.testing.assert_close(*gradients, **TOLERANCE)
    assert all(gradient.any() for gradient in gradients[0])


@each_cell
@pytest.mark.parametrize("spatial", SPATIAL)
def test_mirrored_input_negates_an_equivariant_network(spatial, cell):
    """Of an angle, and with motion of the ranges of a path; the control's features of other frames
    are theirs.
    """
    scene = batch(spatial)
    for motion in (None, MOTION.clone().requires_grad_()):
        turned = None if motion is None else motion * MIRROR
        changes = (
            {"outputs": 1}
            if motion is None
            else {"outputs": 3, "predict": "path", "motion": "visual"}
        )
        net = build(spatial, cell, equivariant=True, **changes)
        output = net(scene, WINDOWS, DT_S, motion)
        assert output.shape == (len(WINDOWS), changes["outputs"])
        torch.testing.assert_close(
            net(scene.mirrored(), WINDOWS, DT_S, turned), -output, **TOLERANCE
        )
        assert output.abs().min() > 1e-6
    (gradient,) = torch.autograd.grad(output.square().sum(), motion)
    assert (gradient.abs() > 0).all()
    plain = build(spatial, cell, motion="visual")
    sides = (
        plain(scene, WINDOWS, DT_S, MOTION),
        plain(scene.mirrored(), WINDOWS, DT_S, MOTION * MIRROR),
    )
    assert (sides[0] + sides[1]).abs().max() > 1e-6
    scenes, kind = torch.tensor([3, 3, 0, 1, 5, 2]), options(spatial).kind
    parts = [frames.FRAME[kind](COUNTS[row], row) for row in scenes.tolist()]
    for either in (plain, net):
        other = either(frames.join(parts), WINDOWS, DT_S, MOTION)
        torch.testing.assert_close(either(scene, WINDOWS, DT_S, MOTION, scenes), other, **TOLERANCE)


@pytest.mark.parametrize("centred", [True, False])
def test_features_are_standardised_over_the_frames_of_a_step(centred):
    """Running statistics are means over the first steps, later moving averages."""
    scale, steps = (
        FeatureScale(3, centred=centred, momentum=0.25).double(),
        torch.randn(9, 5, 3).double() * 4 + 7,
    )
    running = torch.zeros(3).double(), torch.ones(3).double()
    for number, x in enumerate(steps, start=1):
        mean = x.mean(0) * centred
        variance = ((x - mean) ** 2).mean(0)
        torch.testing.assert_close(
            scale(x), ((x - mean) / (variance + EPSILON).sqrt()).tanh(), **TOLERANCE
        )
        weight = max(1 / number, 0.25)
        pairs = zip(running, (mean, variance), strict=True)
        running = tuple((1 - weight) * before + weight * now for before, now in pairs)
    torch.testing.assert_close((scale.mean, scale.variance), running, **TOLERANCE)
    scale.eval()
    expected = ((steps[0] - running[0]) / (running[1] + EPSILON).sqrt()).tanh()
    torch.testing.assert_close(scale(steps[0])[2:3], scale(steps[0][2:3]), **TOLERANCE)
    torch.testing.assert_close(scale(steps[0]), expected, **TOLERANCE)


def test_statistics_count_frames_once():
    """Also a frame that the control's windows share."""
    net, scenes = build().train(), torch.tensor([0, 0, 0, 0, 1, 2])
    net.scale.steps.zero_()
    net(batch(), WINDOWS, DT_S, scenes=scenes)
    torch.testing.assert_close(net.scale.mean, net.spatial(batch()).mean(0), **TOLERANCE)


@pytest.mark.parametrize(
    ("cell", "expected"), [("ltc", -0.04993238503010382), ("lstm", 0.3806235178621074)]
)
def test_a_seed_gives_the_same_numbers_in_all_versions(cell, expected):
    """Initial weights are drawn in float32, whose logarithms differ between CPUs in the last
    bit.
    """
    assert build("gnn", cell)(batch(), WINDOWS, DT_S)[0].item() == pytest.approx(expected, rel=1e-7)


class Counter(TorchDispatchMode):
    """Counts operators but views, which launch nothing."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.count += not func.is_view
        return func(*args, **(kwargs or {}))


def operators(count: int) -> int:
    """Return the operators of forward and backward of sa-gnn-ncp with `count` frames of 20
    points.
    """
    net = entry(equivariant=True, window=8).build("graph").to("meta")
    batch = frames.join([frames.graph(20, seed) for seed in range(count)], "meta")
    windows = torch.from_numpy(np.lib.stride_tricks.sliding_window_view(np.arange(count), 8).copy())
    with Counter() as counter:
        net(
            batch, windows.to("meta"), torch.full(windows.shape, 0.1, device="meta")
        ).sum().backward()
    return counter.count


def test_a_training_step_has_as_many_operators_for_any_number_of_frames(monkeypatch):
    """Pooling or encoding frame by frame would add at least two for each; the recursion has six
    steps a frame.
    """
    monkeypatch.setattr(
        gnn, "normalised_adjacency", lambda degree, *_: torch.empty(2 * degree.shape, device="meta")
    )
    few, many = operators(10), operators(40)
    assert few == many < 600
