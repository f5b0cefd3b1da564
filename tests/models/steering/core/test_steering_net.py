import dataclasses

import pytest
import torch

from models.steering.core.batch import GraphBatch, ImageBatch
from models.steering.core.steering_net import CELL, DEFAULT_CELL, EATS, SPATIAL, TEMPORAL, build, parameter_count

TOLERANCE = {"rtol": 0, "atol": 1e-9}
WINDOWS = torch.tensor([[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]])


def select(batch: GraphBatch, frames: list[int]) -> GraphBatch:
    """The batch of these frames, in this order, built by hand."""
    edge_ptr = torch.cat([torch.zeros(1, dtype=torch.int64), batch.degree.long().cumsum(0)])[batch.ptr]
    pieces, start = [], 0
    for frame in frames:
        rows = slice(batch.ptr[frame], batch.ptr[frame + 1])
        indices = batch.indices[edge_ptr[frame] : edge_ptr[frame + 1]] - batch.ptr[frame] + start
        pieces.append((batch.xyz[rows], batch.cls[rows], batch.degree[rows], indices))
        start += len(pieces[-1][0])
    xyz, cls, degree, indices = (torch.cat(column) for column in zip(*pieces, strict=True))
    return GraphBatch(xyz, cls, torch.tensor([0, *(len(piece[0]) for piece in pieces)]).cumsum(0), degree, indices)


@pytest.mark.parametrize(
    ("temporal", "cell"), [*((name, DEFAULT_CELL) for name in TEMPORAL), ("ncp", "eq4"), ("ncp", "cfc")]
)
@pytest.mark.parametrize("spatial", sorted(SPATIAL.keys() - EATS.keys()))
def test_shared_frames_equal_naive_windows(make_batch, line, spatial, temporal, cell):
    torch.manual_seed(0)
    net = build({**line, "spatial": spatial, "temporal": temporal, "cell": cell}).double()
    batch = make_batch([9, 12, 7, 9, 0, 20])
    dt_s = torch.rand(WINDOWS.shape, dtype=torch.float64) * 0.1 + 0.05

    def loss_and_gradients(predictions):
        loss = (predictions - torch.arange(3)).square().mean()
        return loss, torch.autograd.grad(loss, list(net.parameters()))

    shared = net(batch, WINDOWS, dt_s)
    own = torch.arange(4)[None]
    naive = torch.cat([net(select(batch, window.tolist()), own, dt_s[w : w + 1]) for w, window in enumerate(WINDOWS)])
    assert shared.shape == (3,)
    torch.testing.assert_close(shared, naive, **TOLERANCE)
    loss, gradients = loss_and_gradients(shared)
    torch.testing.assert_close((loss, gradients), loss_and_gradients(naive), **TOLERANCE)
    assert all(gradient.abs().sum() > 0 for gradient in gradients)  # nothing is cut off


@pytest.mark.parametrize("spatial", sorted(EATS))
def test_shared_frames_equal_naive_windows_for_sets_and_images(make_sets, line, spatial):
    torch.manual_seed(0)
    features = {"features": 8}  # a multiple of the CNN's maps
    counts = [20, 9, 30, 12, 1, 25]
    image = torch.randint(0, 256, (6, 32, 40, 3), dtype=torch.uint8)
    net = build({**line, **features, "spatial": spatial}, EATS[spatial], levels=2, image_size=(32, 40)).double()
    batch = make_sets(counts) if spatial == "pointnet2" else ImageBatch(image)
    dt_s = torch.rand(WINDOWS.shape, dtype=torch.float64) * 0.1 + 0.05
    shared = net(batch, WINDOWS, dt_s)
    frames = [make_sets(counts, only=n) if spatial == "pointnet2" else ImageBatch(image[n : n + 1]) for n in range(6)]
    features = torch.cat([net.encode(frame) for frame in frames])
    naive = torch.cat([
        net.temporal(net.temporal.sense(features[window])[None], dt_s[w : w + 1])[0][:, -1, 0]
        for w, window in enumerate(WINDOWS)
    ])  # fmt: skip
    torch.testing.assert_close(shared, naive, **TOLERANCE)
    gradients = torch.autograd.grad(shared.square().sum(), list(net.parameters()))
    assert all(gradient.abs().sum() > 0 for gradient in gradients)  # nothing is cut off


@pytest.mark.parametrize("temporal", TEMPORAL)
@pytest.mark.parametrize("spatial", sorted(SPATIAL))
def test_a_mirrored_world_steers_an_equivariant_network_the_other_way(make_batch, make_sets, line, spatial, temporal):
    torch.manual_seed(0)
    kind = EATS.get(spatial, "graph")
    image = torch.randint(0, 256, (6, 32, 40, 3), dtype=torch.uint8)
    counts = [20, 9, 30, 12, 1, 25]
    batch = {"graph": make_batch, "pointnet2": make_sets}[kind](counts) if kind != "image" else ImageBatch(image)
    dt_s = torch.rand(WINDOWS.shape, dtype=torch.float64) * 0.1 + 0.05
    line = {**line, "features": 8, "spatial": spatial, "temporal": temporal}
    plain, equivariant = (
        build({**line, "equivariant": on}, kind, levels=2, image_size=(32, 40)).double() for on in (False, True)
    )
    here, there = equivariant(batch, WINDOWS, dt_s), equivariant(batch.mirrored(), WINDOWS, dt_s)
    torch.testing.assert_close(there, -here, **TOLERANCE)
    assert here.abs().min() > 1e-6
    assert (plain(batch, WINDOWS, dt_s) + plain(batch.mirrored(), WINDOWS, dt_s)).abs().max() > 1e-6
    assert parameter_count(plain) == parameter_count(equivariant)


@pytest.mark.parametrize(
    ("spatial", "kind", "message"),
    [
        ("cnn", "graph", "cnn eats images .*, and input: semantic holds kNN graphs"),
        ("cnn", "pointnet2", "cnn eats images .* holds points with neighbourhood: pointnet2"),
        ("gnn", "image", "gnn eats kNN graphs, and input: semantic holds images"),
        ("gnn", "pointnet2", "gnn eats kNN graphs, and input: semantic holds points with"),
        ("pointnet2", "graph", "pointnet2 eats points with .* holds kNN graphs"),
    ],
)
def test_a_network_on_an_input_that_it_does_not_eat(line, spatial, kind, message):
    with pytest.raises(ValueError, match=f"spatial: {message}.*: change one"):
        build({**line, "spatial": spatial}, kind, levels=2, image_size=(32, 40))


def test_same_seed_same_network(line):
    weights = []
    for _ in range(2):
        torch.manual_seed(5)
        weights.append(build(line).state_dict())
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])


def test_only_the_last_frames_prediction_is_returned(make_batch, line):
    net = build(line).double()
    batch = make_batch([10, 10])
    dt_s = torch.full((1, 1), 0.1, dtype=torch.float64)
    moved = dataclasses.replace(batch, xyz=torch.cat([batch.xyz[:10], batch.xyz[10:] + 5]))
    first, last = torch.tensor([[0]]), torch.tensor([[1]])
    assert torch.equal(net(batch, first, dt_s), net(moved, first, dt_s))
    assert not torch.equal(net(batch, last, dt_s), net(moved, last, dt_s))


@pytest.mark.parametrize("cell", sorted(CELL))
@pytest.mark.parametrize("spatial", sorted(SPATIAL))
def test_mixed_precision_keeps_the_recursion_exact(make_batch, make_sets, line, spatial, cell):
    torch.manual_seed(0)
    kind = EATS.get(spatial, "graph")
    net = build({**line, "features": 8, "spatial": spatial, "cell": cell}, kind, levels=2, image_size=(32, 40))
    image = torch.randint(0, 256, (3, 32, 40, 3), dtype=torch.uint8)
    batch = {"graph": make_batch([12, 12, 12]), "pointnet2": make_sets([12, 12, 12]), "image": ImageBatch(image)}[kind]
    dt_s = torch.full((1, 3), 0.1)
    windows = torch.tensor([[0, 1, 2]])
    with torch.autocast("cpu", dtype=torch.bfloat16):
        mixed = net(batch, windows, dt_s)
        mixed.sum().backward()
    assert mixed.dtype == torch.float32
    assert all(parameter.grad.isfinite().all() for parameter in net.parameters())
    torch.testing.assert_close(mixed, net(batch, windows, dt_s), rtol=0, atol=0.1)


@pytest.mark.parametrize(
    ("part", "known"), [("spatial", "gnn | edgeconv | gatv2"), ("temporal", "ncp | lstm"), ("cell", "ltc | eq4 | cfc")]
)
def test_unknown_network_lists_the_known(line, part, known):
    with pytest.raises(ValueError, match=rf"{part}: 'gru' is no network .*{known}".replace("|", r"\|")):
        build({**line, part: "gru"})


def test_a_cell_needs_a_network_that_has_cells(line):
    with pytest.raises(ValueError, match=r"cell: 'cfc' is a cell of temporal: ncp, not of lstm"):
        build({**line, "temporal": "lstm", "cell": "cfc"})


@pytest.mark.parametrize("wiring", [{"motor_fanin": 6}, {"sensory_fanout": 9}])
def test_impossible_wiring_is_named(line, wiring):
    with pytest.raises(ValueError, match=f"wiring: {next(iter(wiring))}"):
        build({**line, "wiring": {**line["wiring"], **wiring}})


def test_parameter_count_of_the_default_line(line):
    line |= {"layers": [32, 32, 64], "features": 32, "units": 32, "wiring": {}}
    spatial = (25 + 1) * 32 + (32 + 1) * 32 + (32 + 1) * 64 + (128 + 1) * 32
    assert parameter_count(build(line)) == spatial + 4 * (32 * 6 + 60) + 3 * 19 + 2 * 32 + 2
    assert parameter_count(build({**line, "cell": "eq4"})) == spatial + (32 * 6 + 60) + 19 + 32 * 19 + 2
    layers = [(32, 12, 32 * 6), (12, 6, 12 * 4), (6, 1, 6)]  # heard, neurons, synapses between
    cfc = sum(2 * (synapses + own**2) + 2 * (heard + own) * own + 4 * own for heard, own, synapses in layers)
    assert parameter_count(build({**line, "cell": "cfc"})) == spatial + cfc + 2
    assert parameter_count(build({**line, "temporal": "lstm"})) == spatial + 4 * 32 * (32 + 32 + 2) + 33
