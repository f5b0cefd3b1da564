import dataclasses

import pytest
import torch
from torch.nn import functional

from models.steering.core.batch import SetBatch
from models.steering.core.features import node_features
from models.steering.spatial.pointnet2 import OFFSET_M, Options, PointNet2

TOLERANCE = {"rtol": 0, "atol": 1e-9}


@pytest.fixture
def network():
    torch.manual_seed(0)
    return PointNet2(5, 2, Options(width=0.125, semantics=1.0)).double()


def plain_mlp(layers, row):
    """Reference MLP of Linear, LayerNorm, ReLU on one row."""
    for linear, norm, _ in zip(layers[::3], layers[1::3], layers[2::3], strict=True):
        row = linear.weight @ row + linear.bias
        row = (row - row.mean()) / (row.var(correction=0) + norm.eps).sqrt() * norm.weight + norm.bias
        row = row.clamp_min(0)
    return row


def plain_level(layer, xyz, f, centres, neighbours):
    """Reference of paper eq. 2, one centre and one neighbour at a time."""
    rows = []
    for centre, ball in zip(centres.tolist(), neighbours.tolist(), strict=True):
        described = [plain_mlp(layer.mlp, torch.cat([(xyz[j] - xyz[centre]) / OFFSET_M, f[j]])) for j in ball]
        rows.append(torch.stack(described).max(0).values)
    return torch.stack(rows)


def test_network_equals_plain_loops(make_sets, network):
    batch = make_sets([30, 18])
    expected = []
    xyz, f, ptr = batch.xyz, node_features(batch.xyz, batch.cls, 1.0), batch.ptr
    for layer, level in zip(network.levels, batch.levels, strict=True):
        f = plain_level(layer, xyz, f, level.centres, level.neighbours)
        xyz, ptr = xyz[level.centres], level.ptr
    for start, stop in zip(ptr[:-1].tolist(), ptr[1:].tolist(), strict=True):
        rows = [plain_mlp(network.whole, torch.cat([xyz[i] / OFFSET_M, f[i]])) for i in range(start, stop)]
        row = plain_mlp(network.head, torch.stack(rows).max(0).values)
        expected.append(torch.tanh(functional.linear(row, network.read_out.weight, network.read_out.bias)))
    torch.testing.assert_close(network(batch), torch.stack(expected), **TOLERANCE)


def test_order_of_points_and_of_neighbours_changes_nothing(make_sets, network):
    batch = make_sets([40])
    order = torch.randperm(40)
    place = order.argsort()
    first, second = batch.levels
    turn = torch.randperm(len(first.centres))
    back = turn.argsort()
    shuffled = SetBatch(
        batch.xyz[order],
        batch.cls[order],
        batch.ptr,
        (
            dataclasses.replace(
                first, centres=place[first.centres[turn]], neighbours=place[first.neighbours[turn]].flip(1)
            ),
            dataclasses.replace(second, centres=back[second.centres], neighbours=back[second.neighbours]),
        ),
    )
    torch.testing.assert_close(network(shuffled), network(batch), **TOLERANCE)


@pytest.mark.parametrize("counts", [[30, 30, 30], [30, 0, 1, 17]])
def test_batch_equals_single_frames(make_sets, network, counts):
    together = network(make_sets(counts))
    singles = [network(make_sets(counts, only=frame)) for frame in range(len(counts))]
    torch.testing.assert_close(together, torch.cat(singles), **TOLERANCE)
