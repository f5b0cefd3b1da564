"""Each spatial network beside its oracle, and alone or in a batch; node features."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from models.steering.core.batch import Batch, GraphBatch, ImageBatch, from_arrays
from models.steering.core.features import GEOMETRY, node_features
from models.steering.core.options import Sizes, load_options
from models.steering.spatial import gnn, pointnet2, pyg
from models.steering.spatial.pointnet2 import OFFSET_M
from pipeline.camera import classes
from tests.models.steering import frames

TOLERANCE = {"rtol": 0, "atol": 1e-9}
SMALL: dict[str, Any] = {"layers": [8, 16], "semantics": 0.7, "width": 0.125}
SMALL |= {"centres": [12, 4], "radius_m": [8.0, 16.0], "neighbours": [5, 6]}
HEADS = {"layer_options": {"heads": 2}}
PYG: dict[str, Any] = {
    "GCNConv": {},
    "GATv2Conv": HEADS,
    "SAGEConv": {},
    "TransformerConv": HEADS,
    "EdgeConv": {},
}
FILES = [file.stem for file in Path("models/steering/spatial").glob("[!_]*.py")]
NETWORKS = sorted({*FILES, *PYG} - {"pyg"})
each_network = pytest.mark.parametrize("name", NETWORKS)


def keys(name: str) -> dict[str, Any]:
    """Return the keys of an entry with a network, by its file's name or by a layer of PyG."""
    if name in PYG:
        return {"spatial": "pyg", "layer": name, **PYG[name]}
    return {"spatial": name}


def build(name: str) -> tuple[Any, Any]:
    """Return a small network in float64, and its options."""
    torch.manual_seed(0)
    values = SMALL | keys(name)
    file = load_options("spatial", values["spatial"])
    options = file.model_validate({k: v for k, v in values.items() if k in file.model_fields})
    net = options.build(Sizes(8, **frames.CONTENTS[str(options.kind)])).double()
    for parameter in net.parameters():
        if parameter.ndim == 1:  # biases, which start as 0
            torch.nn.init.normal_(parameter, std=0.3)
    return net, options


def test_blocks_and_mirror_images_have_all_columns():
    arrays = frames.concatenated([frames.graph(count, count) for count in (20, 0, 7)])
    wind = np.random.default_rng(0).normal(size=(27, 2)).astype(np.float32)
    batch = from_arrays({**arrays, "wind": wind, "wind_signs": np.float32([1, -1])})
    assert isinstance(batch, GraphBatch)
    blocks = [*batch.blocks(10)]
    assert [block.frames for block in blocks] == [1, 2]
    for name in ("xyz", "cls", "degree", "wind"):
        parts = [block.columns[name] for block in blocks]
        np.testing.assert_array_equal(torch.cat(parts), arrays.get(name, wind))

    signs = {"xyz": [-1, 1, 1], "wind": [1, -1]}
    for part in (batch, *blocks):
        mirrored = part.mirrored().columns
        assert mirrored.keys() == part.columns.keys()
        for name, values in part.columns.items():
            expected = values * torch.tensor(signs.get(name, 1))
            np.testing.assert_array_equal(mirrored[name], expected)


@each_network
@pytest.mark.parametrize("counts", [[30, 0, 1, 17, 45], [12, 12, 12]])
def test_batch_equals_single_frames(name, counts, device):
    """Frames have equal or other numbers of points, or none; the batch is on a GPU, too."""
    net, options = build(name)
    parts = [frames.FRAME[options.kind](count, count) for count in counts]
    alone = torch.cat([net(frames.join([part], options=options)) for part in parts])
    together = net.to(device)(frames.join(parts, device, options)).cpu()
    assert together.shape == (len(counts), 8)
    torch.testing.assert_close(together, alone, **TOLERANCE)


@pytest.mark.parametrize("layers", [(30, 5, 12), (4,)])
@pytest.mark.parametrize("block", [4, 30, 10**6])  # points: a frame each, some frames, all
def test_gcn_equals_pyg(monkeypatch, layers, block):
    """Outputs, and the gradients of all weights."""
    monkeypatch.setattr(gnn.GCN, "block", block)
    batch = frames.batch([20, 0, 1, 11])
    assert isinstance(batch, GraphBatch)
    torch.manual_seed(0)
    net = gnn.GCN(5, gnn.Options(layers=layers, semantics=0.7)).double()
    peer = pyg.PyG(5, pyg.Options(layer="GCNConv", layers=layers, semantics=0.7)).double()
    peer.read_out.load_state_dict(net.read_out.state_dict())
    for ours, theirs in zip(net.layers, peer.layers, strict=True):
        nn.init.normal_(ours.bias)
        theirs.lin.weight.data = ours.weight.data.T.clone()
        theirs.bias.data = ours.bias.data.clone()
    output = net(batch)
    expected = peer(batch)
    torch.testing.assert_close(output, expected, **TOLERANCE)
    upstream = torch.randn_like(output)
    (output * upstream).sum().backward()
    (expected * upstream).sum().backward()
    for ours, theirs in zip(net.layers, peer.layers, strict=True):
        torch.testing.assert_close(ours.weight.grad, theirs.lin.weight.grad.T, **TOLERANCE)
        torch.testing.assert_close(ours.bias.grad, theirs.bias.grad, **TOLERANCE)
        assert ours.weight.grad.abs().max() > 0.01


def test_the_gcn_computes_mirror_images_with_fewer_products():
    """Outputs, and the gradients of all weights."""
    batch = frames.batch([20, 0, 1, 11])
    net, _ = build("gnn")
    upstream = torch.randn(2, 4, 8).double()
    gradients = []
    outputs = []
    for pair in (net.with_mirrored(batch), [net(batch), net(batch.mirrored())]):
        outputs.append(torch.stack([*pair]))
        (outputs[-1] * upstream).sum().backward()
        gradients.append([parameter.grad.clone() for parameter in net.parameters()])
        net.zero_grad()
    torch.testing.assert_close(*outputs, **TOLERANCE)
    torch.testing.assert_close(*gradients, **TOLERANCE)
    assert (outputs[0][0] - outputs[0][1]).abs().max() > 0.01


def plain_mlp(layers: nn.Sequential, row: Tensor) -> Tensor:
    """Reference MLP of Linear, LayerNorm, ReLU on one row."""
    for linear, norm, _ in zip(layers[::3], layers[1::3], layers[2::3], strict=True):
        row = linear.weight @ row + linear.bias
        spread = (row.var(correction=0) + norm.eps).sqrt()
        row = (row - row.mean()) / spread * norm.weight + norm.bias
        row = row.clamp_min(0)
    return row


def plain_level(layer: Any, xyz: Tensor, f: Tensor, centres: Tensor, neighbours: Tensor) -> Tensor:
    """Reference of paper eq. 2, one centre and one neighbour at a time."""
    rows = []
    for centre, ball in zip(centres.tolist(), neighbours.tolist(), strict=True):
        neighbours = []
        for j in ball:
            offset = (xyz[j] - xyz[centre]) / OFFSET_M
            neighbours.append(plain_mlp(layer.mlp, torch.cat([offset, f[j]])))
        rows.append(torch.stack(neighbours).max(0).values)
    return torch.stack(rows)


def test_pointnet2_equals_plain_loops():
    """Reference: one frame at a time, groups in loops. A frame has fewer points than centres."""
    net, options = build("pointnet2")
    batch: Any = frames.batch([30, 18, 7], options=options)
    expected = []
    for start, stop in pairwise(batch.ptr.tolist()):
        xyz = batch.xyz[start:stop]
        f = node_features(xyz, batch.cls[start:stop], SMALL["semantics"])
        sizes = zip(options.centres, options.radius_m, options.neighbours, strict=True)
        for layer, (count, radius_m, neighbours) in zip(net.levels, sizes, strict=True):
            groups = torch.tensor(plain_groups(xyz, count, radius_m, neighbours))
            f = plain_level(layer, xyz, f, groups[:, 0], groups[:, 1:])
            xyz = xyz[groups[:, 0]]
        rows = [plain_mlp(net.whole, torch.cat([xyz[i] / OFFSET_M, f[i]])) for i in range(len(f))]
        maximum = torch.stack(rows).max(0).values
        expected.append(net.read_out(plain_mlp(net.head, maximum)))
    torch.testing.assert_close(net(batch), torch.stack(expected), **TOLERANCE)


def plain_groups(xyz: Tensor, count: int, radius_m: float, neighbours: int) -> list[list[int]]:
    """Reference of PointNet++'s groups: each centre, then its ball; at most a group per point."""
    numbers = pointnet2.position_hash(xyz.float()).tolist()
    order = sorted(range(len(xyz)), key=numbers.__getitem__)
    points = xyz.float().numpy()

    def squared(a: Any, b: Any) -> Any:
        x, y, z = a - b  # float32, rounded as in the network's file
        return x * x + y * y + z * z

    chosen = [min(order, key=lambda row: squared(points[row], 0 * points[row]))]
    while len(chosen) < min(count, len(xyz)):
        nearest = {}
        for row in order:
            nearest[row] = min(squared(points[row], points[centre]) for centre in chosen)
        chosen.append(max(order, key=nearest.__getitem__))
    groups = []
    for centre in chosen:
        ball = [row for row in order if squared(points[row], points[centre]) <= radius_m**2]
        ball = ball[:neighbours]
        groups.append([centre, *ball, *[ball[0]] * (neighbours - len(ball))])
    return groups


@pytest.mark.parametrize("radius_m", [0.5, 3.0, 100.0])
def test_groups_are_those_of_plain_loops(radius_m):
    """Also in the mirror image, of points in another order, and of points that are equally far."""
    options = pointnet2.Options(
        semantics=0, centres=[40, 10], radius_m=[radius_m, 2 * radius_m], neighbours=[8, 6]
    )
    rng = torch.Generator().manual_seed(0)
    clouds = []
    for count in (120, 0, 1, 13, 120):
        # On a grid of 1/4 m, squared distances have no rounding, and many are equal. Points have
        # different |x|, y or z.
        grid = torch.randint(0, 60, (3 * count, 3), generator=rng).unique(dim=0)
        side = torch.randint(0, 2, (len(grid), 1), generator=rng) * 2 - 1
        points = torch.cat([grid[:, :1] * side, grid[:, 1:]], dim=1) / 4
        clouds.append(points[torch.randperm(len(points), generator=rng)[:count]])
    net = pointnet2.PointNet2(4, options)

    def groups(*clouds: Tensor) -> Tensor:
        ptr = torch.tensor([0, *(len(cloud) for cloud in clouds)]).cumsum(0)
        batch = GraphBatch({"xyz": torch.cat(clouds)}, ptr, indices=torch.empty(0))
        return net.split_groups(options.prepare(batch))[0]

    first = groups(*clouds)
    for cloud, level in zip(clouds, first, strict=True):
        if not len(cloud):
            continue
        expected = plain_groups(cloud, 40, radius_m, 8)
        assert level[: len(expected)].tolist() == expected
        assert all(group in expected for group in level[len(expected) :].tolist())

        turn = torch.randperm(len(cloud), generator=rng)
        mirrored = cloud[turn] * torch.tensor([-1, 1, 1])
        same = groups(mirrored)
        assert torch.equal(turn[same[0]], level.long())


def test_cnn_has_the_layers_of_the_ncp_paper():
    """Reference: one image, layer and map at a time, with explicit padding."""
    net, options = build("cnn")
    batch: Batch = frames.batch([0, 0, 0], options.kind)
    assert isinstance(batch, ImageBatch)
    layers = [layer for layer in net.convolutions if isinstance(layer, nn.Conv2d)]
    sizes = [(layer.out_channels, layer.kernel_size[0], layer.stride[0]) for layer in layers]
    assert sizes == [(24, 5, 2), (36, 5, 2), (48, 3, 2), (64, 3, 1), (8, 3, 1)]
    expected = []
    for image in batch.image.double():
        x = ((image - image.mean()) / image.std(correction=0)).movedim(2, 0)[None]
        for layer in layers:
            margin = layer.kernel_size[0] // 2
            x = functional.pad(x, [margin] * 4)
            x = functional.conv2d(x, layer.weight, layer.bias, layer.stride).relu()
        assert x.shape == (1, 8, 5, 7)  # 33 × 50 halved three times, rounded up
        dense = []
        for number in range(8):
            dense.append(x[0, number].flatten() @ net.weight[number] + net.bias[number])
        expected.append(torch.cat(dense))
    torch.testing.assert_close(net(batch), torch.stack(expected), **TOLERANCE)


def test_classes_enter_in_proportion_to_semantics():
    batch: Any = frames.batch([40])
    half = node_features(batch.xyz, batch.cls, 0.5)
    full = node_features(batch.xyz, batch.cls, 1.0)
    assert torch.equal(half[:, :GEOMETRY], full[:, :GEOMETRY])
    assert torch.equal(half[:, GEOMETRY:], full[:, GEOMETRY:] / 2)
    known = batch.cls < classes.COUNT
    assert torch.equal(full[known, GEOMETRY:].argmax(1), batch.cls[known].long())
    assert torch.equal(full[:, GEOMETRY:].sum(1), known.double())  # void has no class
    mirrored = node_features(batch.mirrored().xyz, batch.cls, 1.0)
    signs = torch.ones(full.shape[1])
    signs[[0, 3]] = -1  # x and the bearing
    assert torch.equal(mirrored, full * signs)
