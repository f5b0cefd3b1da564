"""The contract of the spatial networks, and each one's oracle."""

import math
import warnings
from itertools import pairwise
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from models.steering.core.batch import Batch, GraphBatch, ImageBatch
from models.steering.core.features import node_features
from models.steering.core.graph_network import GraphOptions
from models.steering.core.options import Sizes, load, names
from models.steering.spatial import edgeconv, gatv2, gnn, polar
from models.steering.spatial.pointnet2 import OFFSET_M
from pipeline.camera import classes
from tests.models.steering import frames

with warnings.catch_warnings():  # PyG's own use of torch.jit is deprecated there, and not ours to mend
    warnings.simplefilter("ignore", DeprecationWarning)
    warnings.simplefilter("ignore", FutureWarning)
    from torch_geometric.nn import EdgeConv, GATv2Conv, GCNConv

TOLERANCE = {"rtol": 0, "atol": 1e-9}
SMALL = {"layers": [8, 16], "semantics": 0.7, "width": 0.125, "widths": [6, 8, 8]}
NETWORKS = [*((name, {}) for name in names("spatial")), ("gnn", {"sectors": 5}), ("edgeconv", {"sectors": 3})]
COUNTS = [30, 0, 1, 17, 45]  # points per frame
each_network = pytest.mark.parametrize(("name", "changes"), NETWORKS)


def build(name: str, changes: dict[str, Any] | None = None) -> tuple[Any, str]:
    """Return a small network in float64 and the kind of its frames."""
    torch.manual_seed(0)
    options = load("spatial", name)
    values = {key: value for key, value in SMALL.items() if key in options.model_fields} | (changes or {})
    sizes = Sizes(8, **frames.CONTENTS[options.kind])
    net = options.model_validate(values).build(sizes).double()
    for parameter in net.parameters():  # biases, too
        torch.nn.init.normal_(parameter, std=0.3) if parameter.ndim == 1 else None
    return net, options.kind


@each_network
def test_order_of_points_changes_nothing(name: str, changes: dict[str, Any]) -> None:
    net, kind = build(name, changes)
    parts = [frames.FRAME[kind](count, count) for count in (40, 12)]
    shuffled = [frames.permuted(part, seed) for seed, part in enumerate(parts)]
    torch.testing.assert_close(net(frames.join(shuffled)), net(frames.join(parts)), **TOLERANCE)


@each_network
@pytest.mark.parametrize("counts", [COUNTS, [12, 12, 12]])
def test_batch_equals_single_frames(name: str, changes: dict[str, Any], counts: list[int]) -> None:
    """Of equal and unequal numbers of points, and a frame without points."""
    net, kind = build(name, changes)
    parts = [frames.FRAME[kind](count, count) for count in counts]
    together = net(frames.join(parts))
    assert together.shape == (len(counts), 8)
    torch.testing.assert_close(together, torch.cat([net(frames.join([part])) for part in parts]), **TOLERANCE)


@each_network
def test_both_are_the_frames_and_their_mirror_images(name: str, changes: dict[str, Any]) -> None:
    """And mirroring is no identity, but for a network without input."""
    net, kind = build(name, changes)
    batch = frames.batch(COUNTS, kind)
    original, mirrored = net(batch), net(batch.mirrored())
    assert torch.equal(original, mirrored) == (name == "blind")
    if hasattr(net, "both"):
        torch.testing.assert_close(net.both(batch), (original, mirrored), **TOLERANCE)


@each_network
def test_all_weights_learn_and_features_suit_the_recurrent_network(name: str, changes: dict[str, Any]) -> None:
    net, kind = build(name, changes)
    out = net(frames.batch(COUNTS, kind))
    if name != "cnn":  # ReLU, as in the NCP paper
        assert out.abs().max() <= 1
    parameters = list(net.parameters())
    assert bool(parameters) == (name != "blind")
    if parameters:
        assert all(gradient.any() for gradient in torch.autograd.grad((out * torch.randn_like(out)).sum(), parameters))


@each_network
def test_mixed_precision_is_close(name: str, changes: dict[str, Any]) -> None:
    net, kind = build(name, changes)
    batch, net = frames.batch(COUNTS, kind), net.float()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        mixed = net(batch).float()
    torch.testing.assert_close(mixed, net(batch).float(), rtol=0.1, atol=0.15)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@each_network
@pytest.mark.parametrize("counts", [COUNTS, [12, 12, 12]])
def test_a_gpu_computes_the_same(name: str, changes: dict[str, Any], counts: list[int]) -> None:
    net, kind = build(name, changes)
    parts = [frames.FRAME[kind](count, count) for count in counts]
    expected = net(frames.join(parts))
    torch.testing.assert_close(net.cuda()(frames.join(parts, "cuda")).cpu(), expected, **TOLERANCE)


def same_gradients(ours: Tensor, theirs: Tensor, mine: list[Tensor], peers: list[Tensor]) -> None:
    """Compare outputs and the gradients of pairs of tensors, which may be transposed."""
    torch.testing.assert_close(ours, theirs, **TOLERANCE)
    upstream = torch.randn_like(ours)
    gradients = torch.autograd.grad((ours * upstream).sum(), mine)
    for own, peer in zip(gradients, torch.autograd.grad((theirs * upstream).sum(), peers), strict=True):
        turned = own.shape != peer.shape and own.shape == peer.shape[::-1]
        peer = peer.mT if turned else peer.view_as(own)
        torch.testing.assert_close(own, peer, **TOLERANCE)
        assert own.abs().max() > 0.01


def graph_batch(counts: list[int]) -> GraphBatch:
    batch = frames.batch(counts)
    assert isinstance(batch, GraphBatch)
    return batch


@pytest.mark.parametrize("layers", [(30, 40), (30, 5, 12), (4,)])  # the sparse product before and after the dense one
@pytest.mark.parametrize("block", [4, 30, 10**6])  # points: a frame each, some frames, all
@pytest.mark.parametrize("versions", [1, 2])  # the frames; and their mirror images
def test_gcn_equals_pyg(monkeypatch: pytest.MonkeyPatch, layers: Any, block: int, versions: int) -> None:
    monkeypatch.setattr(gnn.GCN, "block", block)
    batch = graph_batch([20, 0, 1, 11])
    torch.manual_seed(0)
    net = gnn.GCN(5, GraphOptions(layers=layers, semantics=0.7)).double()
    peers, mine, theirs = [], [], []
    for layer in net.layers:
        nn.init.normal_(layer.bias)
        peers.append(GCNConv(*layer.weight.shape).double())
        peers[-1].lin.weight.data, peers[-1].bias.data = layer.weight.data.T.clone(), layer.bias.data.clone()
        mine, theirs = [*mine, layer.weight, layer.bias], [*theirs, peers[-1].lin.weight, peers[-1].bias]
    expected = []
    for side in (batch, batch.mirrored())[:versions]:
        x = node_features(side.xyz, side.cls, 0.7)
        for peer in peers:
            x = peer(x, batch.edge_index).relu()
        rows = [
            (part.mean(0), part.amax(0)) if len(part) else x.new_zeros(2, x.shape[1])
            for part in x.split([20, 0, 1, 11])
        ]
        expected.append(torch.stack([torch.cat([*pair]) for pair in rows]))
    outputs = torch.tanh(net.read_out(torch.stack(expected, dim=1)))
    same_gradients(torch.stack(net.both(batch, versions), dim=1), outputs, mine, theirs)


@pytest.mark.parametrize("equal_rows", [False, True])
def test_edgeconv_equals_pyg(equal_rows: bool) -> None:
    """With ReLU after our maximum and before PyG's; nodes that look alike, whose maxima tie, included."""
    batch = graph_batch([20, 0, 1, 11])
    torch.manual_seed(0)
    layer = edgeconv.EdgeConvLayer(5, 8).double()
    peer = EdgeConv(nn.Sequential(nn.Linear(10, 8), nn.ReLU())).double()
    peer.nn[0].load_state_dict(layer.linear.state_dict())
    x = torch.randn(32, 5, dtype=torch.float64)
    if equal_rows:  # in multiples of 1/8, so that equal sums are equal to the last bit
        x[1::2] = x[::2]
        for tensor in (x, *(parameter.data for parameter in (*layer.parameters(), *peer.parameters()))):
            tensor.mul_(8).round_().div_(8)
    x.requires_grad_()
    ours, theirs = layer(x, layer.operator(batch, x.dtype)).relu(), peer(x, batch.edge_index)
    assert not ours[20].any()  # alone in its frame
    same_gradients(ours, theirs, [x, *layer.parameters()], [x, *peer.parameters()])


@pytest.mark.parametrize(("outputs", "heads"), [(8, 4), (6, 2), (5, 1)])
def test_gatv2_equals_pyg(outputs: int, heads: int) -> None:
    batch = graph_batch([20, 0, 1, 11])
    torch.manual_seed(0)
    layer = gatv2.GATv2Layer(3, outputs).double()
    for parameter in layer.parameters():
        nn.init.normal_(parameter)
    peer = GATv2Conv(3, outputs // heads, heads=heads, add_self_loops=True).double()
    peer.lin_l.load_state_dict(layer.left.state_dict())
    peer.lin_r.load_state_dict(layer.right.state_dict())
    peer.att.data, peer.bias.data = layer.attention.data[None].clone(), layer.bias.data.clone()
    x = torch.randn(32, 3, dtype=torch.float64, requires_grad=True)
    ours, theirs = layer(x, layer.operator(batch, x.dtype)), peer(x, batch.edge_index)
    mine = [x, layer.attention, layer.bias, *layer.left.parameters(), *layer.right.parameters()]
    same_gradients(ours, theirs, mine, [x, peer.att, peer.bias, *peer.lin_l.parameters(), *peer.lin_r.parameters()])


def plain_map(frame: dict[str, Any]) -> Tensor:
    """Return the polar map of one frame, cell by cell."""
    rows = zip(frame["xyz"].tolist(), frame["cls"].tolist(), strict=True)
    points = [(math.hypot(x, z), math.degrees(math.atan2(x, z)), c) for (x, _, z), c in rows]
    edges = [polar.NEAR_M * (polar.FAR_M / polar.NEAR_M) ** (n / polar.RANGES) for n in range(polar.RANGES + 1)]
    width = 90 / polar.BEARINGS
    result = torch.zeros(4, polar.RANGES, polar.BEARINGS)
    for row in range(polar.RANGES):
        for column in range(polar.BEARINGS):
            middle = (column - polar.BEARINGS // 2) * width
            cell = [c for r, b, c in points if edges[row] <= r < edges[row + 1] and abs(b - middle) < width / 2]
            known = [c for c in cell if c != classes.VOID]
            kinds = [["ground" if c in classes.GROUND else "obstacle", "road"][c == classes.ROAD] for c in known]
            for channel, kind in enumerate(["road", "ground", "obstacle"]):
                result[channel, row, column] = kinds.count(kind) / max(1, len(cell))
            result[3, row, column] = not cell
    return result


def test_polar_map_equals_brute_force() -> None:
    parts = [frames.graph(count, seed) for seed, count in enumerate([300, 0, 1, 170])]
    parts[0]["xyz"][:5] = [[0.0, 0, 3.9], [0, 0, 40.1], [9, 0, 8.5], [0, 0, -10], [0, 0, 0]]  # outside of the map
    maps = polar.polar_map(frames.join(parts))
    torch.testing.assert_close(maps, torch.stack([plain_map(part) for part in parts]))
    assert maps[:, :3].sum(dim=(0, 2, 3)).all()  # each of the kinds occurs


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_mirroring_reverses_the_bearings_exactly(dtype: torch.dtype) -> None:
    """Also of points straight ahead and on the border of two cells."""
    frame = frames.graph(400)
    frame["xyz"][:40, 0] = 0
    frame["xyz"][40:80, 0] = frame["xyz"][40:80, 2] * math.tan(math.radians(90 / polar.BEARINGS / 2))
    batch = frames.join([frame | {"xyz": torch.from_numpy(frame["xyz"]).to(dtype).numpy()}])
    assert torch.equal(polar.polar_map(batch.mirrored()), polar.polar_map(batch).flip(3))


def plain_mlp(layers: nn.Sequential, row: Tensor) -> Tensor:
    """Reference MLP of Linear, LayerNorm, ReLU on one row."""
    for linear, norm, _ in zip(layers[::3], layers[1::3], layers[2::3], strict=True):
        row = linear.weight @ row + linear.bias
        row = (row - row.mean()) / (row.var(correction=0) + norm.eps).sqrt() * norm.weight + norm.bias
        row = row.clamp_min(0)
    return row


def plain_level(layer: Any, xyz: Tensor, f: Tensor, centres: Tensor, neighbours: Tensor) -> Tensor:
    """Reference of paper eq. 2, one centre and one neighbour at a time."""
    rows = []
    for centre, ball in zip(centres.tolist(), neighbours.tolist(), strict=True):
        described = [plain_mlp(layer.mlp, torch.cat([(xyz[j] - xyz[centre]) / OFFSET_M, f[j]])) for j in ball]
        rows.append(torch.stack(described).max(0).values)
    return torch.stack(rows)


def test_pointnet2_equals_plain_loops() -> None:
    net, kind = build("pointnet2")
    batch: Any = frames.batch([30, 18], kind)
    expected = []
    xyz, f, ptr = batch.xyz, node_features(batch.xyz, batch.cls, SMALL["semantics"]), batch.ptr
    for layer, level in zip(net.levels, batch.levels, strict=True):
        f = plain_level(layer, xyz, f, level.centres, level.neighbours)
        xyz, ptr = xyz[level.centres], level.ptr
    for start, stop in pairwise(ptr.tolist()):
        rows = [plain_mlp(net.whole, torch.cat([xyz[i] / OFFSET_M, f[i]])) for i in range(start, stop)]
        expected.append(torch.tanh(net.read_out(plain_mlp(net.head, torch.stack(rows).max(0).values))))
    torch.testing.assert_close(net(batch), torch.stack(expected), **TOLERANCE)


def test_cnn_has_the_layers_of_the_ncp_paper() -> None:
    """Reference: one image, layer and map at a time, with explicit padding."""
    net, kind = build("cnn")
    batch: Batch = frames.batch([0, 0, 0], kind)
    assert isinstance(batch, ImageBatch)
    layers = [layer for layer in net.convolutions if isinstance(layer, nn.Conv2d)]
    sizes = [(layer.out_channels, layer.kernel_size[0], layer.stride[0]) for layer in layers]
    assert sizes == [(24, 5, 2), (36, 5, 2), (48, 3, 2), (64, 3, 1), (8, 3, 1)]
    expected = []
    for image in batch.image.double():
        x = ((image - image.mean()) / image.std(correction=0)).movedim(2, 0)[None]
        for layer in layers:
            margin = layer.kernel_size[0] // 2
            x = functional.conv2d(functional.pad(x, [margin] * 4), layer.weight, layer.bias, layer.stride).relu()
        assert x.shape == (1, 8, 5, 7)  # 33 × 50 halved three times, rounded up
        dense = [x[0, number].flatten() @ net.weight[number] + net.bias[number] for number in range(8)]
        expected.append(torch.cat(dense).relu())
    torch.testing.assert_close(net(batch), torch.stack(expected), **TOLERANCE)
