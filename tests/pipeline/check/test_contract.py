"""The contract of networks: faults are named, right ones pass, the included ones are current."""

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch, from_arrays
from models.steering.core.features import NODE_FEATURES, mean_max_pool, node_features
from models.steering.core.options import Sizes, load_options
from models.steering.core.recurrent import NOMINAL_STEP_S, RecurrentCell
from models.steering.core.steering_net import SteeringNet
from models.steering.temporal import lstm
from pipeline.base import checkpoint
from pipeline.base.errors import InputError
from pipeline.check.contract import check_network
from pipeline.check.street_frames import join_frames, make_frames
from pipeline.graphs.settings import Variant
from pipeline.train import trained
from pipeline.train.entry import Entry
from pipeline.train.trained import Trained

FEATURES = 8
IMAGE_SIZE = (48, 96)
VARIANTS = {
    "graph": Variant(source="clouds/pseudo", points=60, k=6, keep_inter_class=0.2),
    "image": Variant(source="ingest"),
}
SPATIAL = [path.stem for path in Path("models/steering/spatial").glob("[!_]*.py")]
TEMPORAL = [path.stem for path in Path("models/steering/temporal").glob("[!_]*.py")]
# Folders of the included networks.
INCLUDED = ("models/steering/sample", "models/steering/sample_path")
# Layers of PyTorch Geometric: attention, a maximum over edges, and a sum.
LAYERS = ["GATv2Conv", "EdgeConv", "GraphConv"]


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(0)


class Net(nn.Module):
    """Pooled features and a dense layer, whose output `change` may change."""

    def __init__(self, change: Callable[[Any, GraphBatch, Tensor], Tensor] | None) -> None:
        super().__init__()
        self.read_out = nn.Linear(2 * NODE_FEATURES, FEATURES)
        self.norm = nn.BatchNorm1d(FEATURES)
        self.frozen = nn.Linear(FEATURES, FEATURES).requires_grad_(False)
        self.low = nn.Linear(FEATURES, FEATURES).bfloat16()
        self.change = change
        self.calls = 0

    def forward(self, batch: GraphBatch) -> Tensor:
        if self.change is moves_points:
            batch.xyz[:, 2] -= 10
        y = self.read_out(mean_max_pool(node_features(batch.xyz, batch.cls, 1.0), batch.ptr))
        return self.change(self, batch, y) if self.change else y


def moves_points(net: Net, batch: GraphBatch, y: Tensor) -> Tensor:
    return y


def per_point(net: Net, batch: GraphBatch, y: Tensor) -> Tensor:
    return node_features(batch.xyz, batch.cls, 1.0)[:, :FEATURES]


def plain_mean(net: Net, batch: GraphBatch, y: Tensor) -> Tensor:
    means = [frame.mean(0) for frame in torch.split(batch.xyz, batch.ptr.diff().tolist())]
    return y + torch.stack(means).sum(1, keepdim=True)


def above_median(net: Net, batch: GraphBatch, y: Tensor) -> Tensor:
    far = torch.stack([f[:, 2].mean() for f in torch.split(batch.xyz, batch.ptr.diff().tolist())])
    return y if net.training else torch.where((far > far.median())[:, None], torch.nan, y)


def counts_calls(net: Net, batch: GraphBatch, y: Tensor) -> Tensor:
    net.calls += 1
    return y * (1 + 0.1 * net.calls)


def first_point(net: Net, batch: GraphBatch, y: Tensor) -> Tensor:
    first = [frame[:1].sum(0) for frame in torch.split(batch.xyz, batch.ptr.diff().tolist())]
    return y + torch.stack(first)[:, :1]


def dropout(net: Net, batch: GraphBatch, y: Tensor) -> Tensor:
    return nn.functional.dropout(y, 0.5)  # in prediction, too


FAULTS: list[tuple[Callable[..., Tensor], str]] = [
    (per_point, r"the shape \[60, 8\] in prediction, expected \[1, 8\]"),
    (lambda net, batch, y: (y, y), r"returns tuple, expected a tensor \[1, 8\]"),
    (lambda net, batch, y: y.double(), "torch.float64 in prediction, expected torch.float32"),
    (lambda net, batch, y: y.detach(), "no weight gets a gradient. Look for detach"),
    (lambda net, batch, y: y / 0 if net.training else y, "NaN or infinity in training"),
    (plain_mean, "NaN or infinity in prediction"),
    (above_median, "NaN or infinity in prediction"),
    (counts_calls, "other values for the same frames when it is called again"),
    (dropout, "other values for the same frames when it is called again"),
    (lambda net, batch, y: y - y.mean(0), "for a frame depends on the other frames of its batch"),
    (first_point, "depend on the order of the points"),
]
RIGHT: list[Callable[..., Tensor] | None] = [
    None,
    moves_points,
    lambda net, batch, y: net.norm(y),
    lambda net, batch, y: net.frozen(y),
    lambda net, batch, y: net.low(y.bfloat16()).float(),
    lambda net, batch, y: nn.functional.dropout(y, 0.5, net.training),
]


def entry(**changes: Any) -> Entry:
    keys = {"input": "semantic", "spatial": "gnn", "temporal": "lstm", "semantics": 1.0}
    return Entry.model_validate(keys | {"features": FEATURES, "window": 4} | changes)


def given(module: nn.Module) -> Any:
    """Return options that build a module."""
    return SimpleNamespace(build=lambda sizes: module, sees_frames=True)


def check(module: nn.Module, **changes: Any) -> None:
    """Check a spatial network."""
    model = entry(**changes)
    net = SteeringNet(given(module), lstm.Options(), Sizes(FEATURES), equivariant=model.equivariant)
    check_network(net, model, VARIANTS["graph"], IMAGE_SIZE, outputs=1)


@pytest.mark.parametrize(("change", "message"), FAULTS)
def test_a_faulty_spatial_network_is_one_line(change, message):
    with pytest.raises(InputError, match=f"^spatial: gnn: .*{message}") as raised:
        check(Net(change))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("change", RIGHT)
def test_a_right_spatial_network_passes(change):
    check(Net(change))


@pytest.mark.parametrize("points", [1, 2])
def test_frames_of_few_points_are_no_fault(points):
    model = entry()
    net = SteeringNet(given(Net(None)), lstm.Options(), Sizes(FEATURES))
    variant = VARIANTS["graph"].model_copy(update={"points": points})
    check_network(net, model, variant, IMAGE_SIZE, outputs=1)


@pytest.mark.parametrize(
    ("layer", "lazy", "tensor"),
    [
        ("read_out", nn.LazyLinear(FEATURES), "weight"),
        ("norm", nn.LazyBatchNorm1d(affine=False), "running_mean"),
    ],
)
def test_a_layer_without_sizes_is_refused(layer, lazy, tensor):
    net = Net(None)
    setattr(net, layer, lazy)
    with pytest.raises(InputError, match=rf"{layer}\.{tensor} has no size before .* LazyLinear"):
        check(net)


def test_a_changed_input_is_refused_if_the_mirror_image_is_made_from_it():
    with pytest.raises(InputError, match="changes its input, from which equivariant: true makes"):
        check(Net(moves_points), equivariant=True)


class Cell(RecurrentCell):
    """A mean over the frames of a window, whose output `change` may change."""

    def __init__(self, change: Callable[[Any, Tensor], Tensor]) -> None:
        super().__init__()
        self.dense = nn.Linear(FEATURES, 1)
        self.change = change
        self.state: Any = 0.0

    def project_inputs(self, x: Tensor) -> Tensor:
        return self.dense(x)

    def forward(self, projected: Tensor, dt_s: Tensor) -> Tensor:
        self.dt_s = dt_s
        frames = torch.arange(1, projected.shape[1] + 1)[:, None]
        return self.change(self, projected.cumsum(1) / frames)


def keeps_state(cell: Cell, y: Tensor) -> Tensor:
    y = y + cell.state
    cell.state = y.mean().detach()
    return y


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda cell, y: y[:, -1], r"the shape \[1, 1\] in prediction, expected \[1, 4, 1\]"),
        (lambda cell, y: y / 0, "NaN or infinity in prediction"),
        (lambda cell, y: y.detach(), "no weight gets a gradient"),
        (keeps_state, "other values for the same windows when it is called again"),
        (lambda cell, y: y - y.mean(0), "for a window depends on the other windows of its batch"),
        (lambda cell, y: y * cell.dt_s.mean(), "depends on the other windows of its batch"),
        ("centred", "depends on the other windows of its batch"),
        (lambda cell, y: y, None),
    ],
)
def test_a_faulty_temporal_network_is_one_line(change, message):
    cell = Cell(change)
    if change == "centred":  # over all frames of a batch, before windows are taken
        cell = Cell(lambda cell, y: y)
        cell.project_inputs = lambda x: cell.dense(x - x.mean(0))  # type: ignore[method-assign]
    net = SteeringNet(given(Net(None)), given(cell), Sizes(FEATURES))
    if message is None:
        check_network(net, entry(), VARIANTS["graph"], IMAGE_SIZE, outputs=1)
        return
    with pytest.raises(InputError, match=f"^temporal: lstm: .*{message}"):
        check_network(net, entry(), VARIANTS["graph"], IMAGE_SIZE, outputs=1)


@pytest.mark.parametrize("equivariant", [False, True])
@pytest.mark.parametrize(
    ("spatial", "temporal", "layer"),
    [
        *((name, "lstm", "GCNConv") for name in SPATIAL),
        *(("gnn", name, "") for name in TEMPORAL),
        *(("pyg", "lstm", layer) for layer in LAYERS),
    ],
)
def test_our_own_networks_keep_the_contract(spatial, temporal, layer, equivariant):
    keys: dict[str, Any] = {"input": "x", "spatial": spatial, "temporal": temporal}
    keys |= {"features": FEATURES, "window": 4, "equivariant": equivariant, "motion": "visual"}
    options = load_options("spatial", spatial)
    if "semantics" in options.model_fields:
        keys["semantics"] = 1.0
    if spatial == "pyg":
        keys["layer"] = layer
    model = Entry.model_validate(keys)
    variant = VARIANTS[str(options.kind)]
    net = model.build(str(options.kind), IMAGE_SIZE, outputs=3)
    check_network(net, model, variant, IMAGE_SIZE, outputs=3)


def run_on_streets(model: Trained) -> Tensor:
    """Return the standardised outputs [W,R] of a network for windows of streets in memory.

    Their time steps and motion vary, and some frames have no points or no measured motion.
    """
    rng = np.random.default_rng(0)
    variant = Variant.model_validate(model.settings["graphs"])
    count = model.entry.window + 3
    counts = [(300, 150, 0, 300)[row % 4] for row in range(count)]
    frames = make_frames(variant, counts, (96, 320), seed=0)
    windows = np.arange(4)[:, None] + np.arange(model.entry.window)
    dt_s = NOMINAL_STEP_S * rng.uniform(0.5, 2, windows.shape)

    motion = None
    if model.net.motion:
        measured = rng.integers(0, 2, count)
        columns = [rng.normal(0, 0.2, count), rng.normal(0, 0.3, count), rng.uniform(1, 15, count)]
        rows = np.stack([*columns, np.ones(count)], axis=1) * measured[:, None]
        motion = torch.from_numpy(rows).float()
    batch = from_arrays(join_frames(frames, model.entry.network))
    with torch.inference_mode():
        return model.net(batch, torch.from_numpy(windows), torch.from_numpy(dt_s).float(), motion)


@pytest.mark.parametrize("folder", INCLUDED)
def test_an_included_network_has_the_outputs_of_its_training_and_the_hashes_of_its_code(
    folder, capsys
):
    """Processors differ by 1e-6 standard deviations. CONTRIBUTING.md says how to renew hashes."""
    expected = checkpoint.read(Path(folder) / "best.pt", trained.KIND)["outputs"]
    outputs = run_on_streets(trained.load_model(folder, "cpu"))
    torch.testing.assert_close(outputs, expected, rtol=0, atol=1e-4)
    assert capsys.readouterr().out == ""


def test_loading_a_network_of_edited_code_prints_one_line(tmp_path, capsys):
    """It is one line for all checkpoints of a model."""
    content = checkpoint.read(Path("models/steering/sample/best.pt"), trained.KIND)
    content["code"]["pipeline/train/quantity.py"] = "another"
    checkpoint.write(tmp_path / "best.pt", content)
    trained.load_model(tmp_path, "cpu")
    trained.load_model(tmp_path, "cpu")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1
    assert re.match(r"\S+: pipeline/train/quantity\.py changed since its training", lines[0])
