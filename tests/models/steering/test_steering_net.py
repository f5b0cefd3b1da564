"""Networks of each combination: shared frames, mirroring, motion, paths, launches."""

from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from models.steering.core.options import NetworkOptions, load_options
from models.steering.core.steering_net import EPSILON, FeatureScale, SteeringNet
from models.steering.spatial import gnn
from models.steering.temporal.ncp import CELLS
from pipeline.train.entry import Entry
from tests.models.steering import frames
from tests.models.steering.test_networks import NETWORKS, SMALL, TOLERANCE, keys

WINDOWS = torch.tensor([[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]])
DT_S = torch.rand(3, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
DT_S = 0.1 * DT_S + 0.05
MOTION = torch.rand(6, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
MOTION *= torch.tensor([0.2, 0.5, 20, 1])
# In the mirror image, angle and yaw rate change sign; speed and valid do not.
MIRROR = torch.tensor([-1.0, -1.0, 1.0, 1.0])
COUNTS = [20, 9, 30, 12, 0, 25]  # points per frame
SPATIAL = [name for name in NETWORKS if name != "blind"]  # blind has no input
WIRING = {"inter": 8, "command": 5, "sensory_fanout": 3, "inter_fanout": 2, "motor_fanin": 3}
WIRING |= {"recurrent_command_synapses": 4}
OPTIONS = SMALL | {"layers": [8, 12], "semantics": 1.0, "units": 7, "wiring": WIRING}
each_cell = pytest.mark.parametrize("cell", ["lstm", *CELLS])


def entry(spatial: str = "gnn", cell: str = "ltc", **changes: Any) -> Entry:
    """Return a small model's entry; `cell`: lstm, or a cell of ncp."""
    temporal = {"temporal": "lstm"} if cell == "lstm" else {"temporal": "ncp", "cell": cell}
    files = (options(spatial), load_options("temporal", temporal["temporal"]))
    fields = {field for file in files for field in file.model_fields}
    small = {key: value for key, value in OPTIONS.items() if key in fields}
    general = {"input": "semantic", "window": 4, "features": 8}
    return Entry.model_validate(general | keys(spatial) | temporal | small | changes)


def options(spatial: str) -> type[NetworkOptions]:
    return load_options("spatial", keys(spatial)["spatial"])


def build(spatial: str = "gnn", cell: str = "ltc", outputs: int = 1, **changes: Any) -> SteeringNet:
    """Return a small network for evaluation, with the statistics of one step of training."""
    torch.manual_seed(0)
    kind = options(spatial).kind
    model = entry(spatial, cell, **changes)
    net = model.build(kind, **frames.CONTENTS[kind], outputs=outputs).double()
    net(batch(spatial), WINDOWS, DT_S, MOTION if net.motion else None)
    return net.eval()


def batch(spatial: str = "gnn") -> Any:
    return frames.batch(COUNTS, options(spatial).kind, entry(spatial).network)


def join(parts: list[Any], spatial: str) -> Any:
    """Return frames as a batch for a small network."""
    return frames.join(parts, options=entry(spatial).network)


@each_cell
@pytest.mark.parametrize("spatial", SPATIAL)
def test_shared_frames_equal_naive_windows(spatial, cell):
    """Values and gradients: each window read and encoded for itself."""
    net = build(spatial, cell)
    make = frames.FRAME[options(spatial).kind]
    parts = [make(count, seed) for seed, count in enumerate(COUNTS)]
    shared = net(join(parts, spatial), WINDOWS, DT_S)
    outputs = []
    for window, dt_s in zip(WINDOWS.tolist(), DT_S, strict=True):
        alone = join([parts[row] for row in window], spatial)
        outputs.append(net(alone, torch.arange(4)[None], dt_s[None]))
    naive = torch.cat(outputs)
    torch.testing.assert_close(shared, naive, **TOLERANCE)
    gradients = torch.autograd.grad(shared.square().sum(), list(net.parameters()))
    expected = torch.autograd.grad(naive.square().sum(), list(net.parameters()))
    torch.testing.assert_close(gradients, expected, **TOLERANCE)
    assert all(gradient.any() for gradient in gradients)


@each_cell
@pytest.mark.parametrize("spatial", SPATIAL)
@pytest.mark.parametrize("equivariant", [True, False])
def test_mirrored_input_and_motion_negate_an_equivariant_network(equivariant, spatial, cell):
    scene = batch(spatial)
    net = build(spatial, cell, outputs=3, equivariant=equivariant, motion="visual")
    motion = MOTION.clone().requires_grad_()
    output = net(scene, WINDOWS, DT_S, motion)
    mirrored = net(scene.mirrored(), WINDOWS, DT_S, motion * MIRROR)
    assert output.shape == (len(WINDOWS), 3)
    assert output.abs().min() > 1e-6
    assert torch.allclose(mirrored, -output, **TOLERANCE) == equivariant
    (gradient,) = torch.autograd.grad(output.square().sum(), motion)
    assert (gradient.abs() > 0).all()


@pytest.mark.parametrize("centred", [True, False])
def test_features_are_standardised_over_the_frames_of_a_step(centred):
    """Running statistics are means over the first steps, later moving averages."""
    scale = FeatureScale(3, centred=centred, momentum=0.25).double()
    steps = torch.randn(9, 5, 3).double() * 4 + 7
    running_mean = torch.zeros(3).double()
    running_variance = torch.ones(3).double()
    for number, x in enumerate(steps, start=1):
        mean = x.mean(0) * centred
        variance = ((x - mean) ** 2).mean(0)
        expected = ((x - mean) / (variance + EPSILON).sqrt()).tanh()
        torch.testing.assert_close(scale(x), expected, **TOLERANCE)
        weight = max(1 / number, 0.25)
        running_mean = (1 - weight) * running_mean + weight * mean
        running_variance = (1 - weight) * running_variance + weight * variance
    torch.testing.assert_close(scale.mean, running_mean, **TOLERANCE)
    torch.testing.assert_close(scale.variance, running_variance, **TOLERANCE)
    scale.eval()
    expected = ((steps[0] - running_mean) / (running_variance + EPSILON).sqrt()).tanh()
    torch.testing.assert_close(scale(steps[0])[2:3], scale(steps[0][2:3]), **TOLERANCE)
    torch.testing.assert_close(scale(steps[0]), expected, **TOLERANCE)


@pytest.mark.parametrize(
    ("cell", "expected"), [("ltc", -0.04993238503010382), ("lstm", 0.3806235178621074)]
)
def test_a_seed_gives_the_same_numbers_in_all_versions(cell, expected):
    """Initial weights are drawn in float32, whose logarithms differ between CPUs by a bit.

    Outputs differ by 1.6e-7 then, and by a multiple if anything else is drawn.
    """
    assert build("gnn", cell)(batch(), WINDOWS, DT_S)[0].item() == pytest.approx(expected, rel=1e-5)


class Counter(TorchDispatchMode):
    """Counts operators but views, which launch nothing."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.count += not func.is_view
        return func(*args, **(kwargs or {}))


def operators(count: int) -> int:
    """Return the operators of a step of sa-gnn-ncp with `count` frames of 20 points."""
    net = entry(equivariant=True, window=8).build("graph").to("meta")
    batch = frames.join([frames.graph(20, seed) for seed in range(count)], "meta")
    windows = torch.arange(count).unfold(0, 8, 1).to("meta")
    dt_s = torch.full(windows.shape, 0.1, device="meta")
    with Counter() as counter:
        net(batch, windows, dt_s).sum().backward()
    return counter.count


def test_a_training_step_has_as_many_operators_for_any_number_of_frames(monkeypatch):
    """The recursion has six steps a frame; other operators frame by frame would add two each."""
    monkeypatch.setattr(
        gnn, "normalised_adjacency", lambda degree, *_: torch.empty(2 * degree.shape, device="meta")
    )
    few = operators(10)
    assert few == operators(40)
    assert few < 600
