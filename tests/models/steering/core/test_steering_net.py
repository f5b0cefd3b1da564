import dataclasses
import inspect
import json

import pytest
import torch

from models.steering.core import steering_net
from models.steering.core.batch import GraphBatch, ImageBatch
from models.steering.core.network_file import Network, names
from models.steering.core.steering_net import GENERAL, KINDS, build, parameter_count, resolved
from pipeline.sections.models import Model

TOLERANCE = {"rtol": 0, "atol": 1e-9}
WINDOWS = torch.tensor([[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]])
KIND = {name: Network("spatial", name).module.INPUT for name in names("spatial") if name != "blind"}  # it sees nothing
RECURRENT = [*((name, {}) for name in names("temporal")), *(("ncp", {"cell": name}) for name in names("cell"))]
IMAGE = torch.randint(0, 256, (6, 32, 40, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
MOTION = torch.rand(6, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * torch.tensor(
    [0.2, 0.5, 20, 1]
)
CONTENTS = {"graph": {}, "pointnet2": {"levels": 2}, "image": {"image_size": (32, 40)}}


def net_of(line: dict[str, object]) -> steering_net.SteeringNet:
    """The line's network, whatever its input."""
    kind = KIND.get(line["spatial"], "graph")
    return build(line, kind, **CONTENTS[kind])


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


@pytest.mark.parametrize(("temporal", "knobs"), RECURRENT)
@pytest.mark.parametrize("spatial", [name for name in KIND if KIND[name] == "graph"])
def test_shared_frames_equal_naive_windows(make_batch, make_line, spatial, temporal, knobs):
    torch.manual_seed(0)
    net = net_of(make_line(spatial, temporal, **knobs)).double()
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


@pytest.mark.parametrize("spatial", [name for name in KIND if KIND[name] != "graph"])
def test_shared_frames_equal_naive_windows_for_sets_and_images(make_sets, make_line, spatial):
    torch.manual_seed(0)
    counts = [20, 9, 30, 12, 1, 25]
    net = net_of(make_line(spatial)).double()
    of_sets = KIND[spatial] == "pointnet2"
    batch = make_sets(counts) if of_sets else ImageBatch(IMAGE)
    dt_s = torch.rand(WINDOWS.shape, dtype=torch.float64) * 0.1 + 0.05
    shared = net(batch, WINDOWS, dt_s)
    frames = [make_sets(counts, only=n) if of_sets else ImageBatch(IMAGE[n : n + 1]) for n in range(6)]
    features = torch.cat([net.encode(frame) for frame in frames])
    naive = torch.cat([
        net.temporal(net.temporal.sense(features[window])[None], dt_s[w : w + 1])[0][:, -1, 0]
        for w, window in enumerate(WINDOWS)
    ])  # fmt: skip
    torch.testing.assert_close(shared, naive, **TOLERANCE)
    gradients = torch.autograd.grad(shared.square().sum(), list(net.parameters()))
    assert all(gradient.abs().sum() > 0 for gradient in gradients)  # nothing is cut off


@pytest.mark.parametrize("temporal", names("temporal"))
@pytest.mark.parametrize("spatial", KIND)
def test_a_mirrored_world_steers_an_equivariant_network_the_other_way(
    make_batch, make_sets, make_line, spatial, temporal
):
    torch.manual_seed(0)
    counts = [20, 9, 30, 12, 1, 25]
    batch = {"graph": make_batch(counts), "pointnet2": make_sets(counts), "image": ImageBatch(IMAGE)}[KIND[spatial]]
    dt_s = torch.rand(WINDOWS.shape, dtype=torch.float64) * 0.1 + 0.05
    plain, equivariant = (net_of(make_line(spatial, temporal, equivariant=on)).double() for on in (False, True))
    here, there = equivariant(batch, WINDOWS, dt_s), equivariant(batch.mirrored(), WINDOWS, dt_s)
    torch.testing.assert_close(there, -here, **TOLERANCE)
    assert here.abs().min() > 1e-6
    assert (plain(batch, WINDOWS, dt_s) + plain(batch.mirrored(), WINDOWS, dt_s)).abs().max() > 1e-6
    assert parameter_count(plain) == parameter_count(equivariant)


@pytest.mark.parametrize(("temporal", "knobs"), RECURRENT)
@pytest.mark.parametrize("spatial", KIND)
def test_so_it_does_when_the_motion_is_mirrored_too(make_batch, make_sets, make_line, spatial, temporal, knobs):
    torch.manual_seed(0)
    counts = [20, 9, 30, 12, 1, 25]
    batch = {"graph": make_batch(counts), "pointnet2": make_sets(counts), "image": ImageBatch(IMAGE)}[KIND[spatial]]
    dt_s = torch.rand(WINDOWS.shape, dtype=torch.float64) * 0.1 + 0.05
    net = net_of(make_line(spatial, temporal, motion="visual", equivariant=True, **knobs)).double()
    motion = MOTION.clone().requires_grad_()
    here = net(batch, WINDOWS, dt_s, motion)
    there = net(batch.mirrored(), WINDOWS, dt_s, motion * torch.tensor([-1, -1, 1, 1]))
    torch.testing.assert_close(there, -here, **TOLERANCE)
    assert here.abs().min() > 1e-6
    (heard,) = torch.autograd.grad(here.square().sum(), motion)
    assert (heard.abs() > 0).all()  # of every frame, all that it did


@pytest.mark.parametrize(("temporal", "knobs"), RECURRENT)
def test_all_of_a_network_with_motion_learns(make_batch, make_line, temporal, knobs):
    torch.manual_seed(0)
    net = net_of(make_line("gnn", temporal, motion="lidar", **knobs)).double()
    batch, dt_s = make_batch([9, 12, 7, 9, 5, 20]), torch.full(WINDOWS.shape, 0.1, dtype=torch.float64)
    left_open = net(batch, WINDOWS, dt_s, MOTION)
    assert left_open.abs().max() < 3  # deviations of what the measured angle leaves open
    gradients = torch.autograd.grad(left_open.square().sum(), list(net.parameters()))
    assert all(gradient.abs().sum() > 0 for gradient in gradients)  # nothing is cut off
    with pytest.raises(ValueError, match="motion"):
        net(batch, WINDOWS, dt_s)


def test_without_motion_a_seed_gives_the_numbers_that_it_always_gave(make_batch, make_line):
    batch, dt_s = make_batch([9, 12, 7, 9, 5, 20]), torch.full(WINDOWS.shape, 0.1, dtype=torch.float64)
    always = {"ncp": 0.61231783739338, "lstm": 0.26132779169831866}  # of the code that knew no motion
    for temporal, knobs in (("ncp", {}), ("ncp", {"motion": "none"}), ("lstm", {})):
        torch.manual_seed(3)
        net = net_of(make_line("gnn", temporal, **knobs)).double()
        assert net(batch, WINDOWS, dt_s)[0].item() == pytest.approx(always[temporal], rel=1e-9)


@pytest.mark.parametrize("spatial", KIND)
def test_an_input_of_another_kind_is_refused(make_line, spatial):
    for kind in KINDS.keys() - {KIND[spatial]}:
        with pytest.raises(ValueError, match=f"^spatial = '{spatial}' expects {KINDS[KIND[spatial]]}.*{KINDS[kind]}"):
            build(make_line(spatial), kind, levels=2, image_size=(32, 40))


def test_same_seed_same_network(make_line):
    weights = []
    for _ in range(2):
        torch.manual_seed(5)
        weights.append(build(make_line()).state_dict())
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])


def test_only_the_last_frames_prediction_is_returned(make_batch, make_line):
    net = build(make_line()).double()
    batch = make_batch([10, 10])
    dt_s = torch.full((1, 1), 0.1, dtype=torch.float64)
    moved = dataclasses.replace(batch, xyz=torch.cat([batch.xyz[:10], batch.xyz[10:] + 5]))
    first, last = torch.tensor([[0]]), torch.tensor([[1]])
    assert torch.equal(net(batch, first, dt_s), net(moved, first, dt_s))
    assert not torch.equal(net(batch, last, dt_s), net(moved, last, dt_s))


@pytest.mark.parametrize("cell", names("cell"))
@pytest.mark.parametrize("spatial", KIND)
def test_mixed_precision_keeps_the_recursion_exact(make_batch, make_sets, make_line, spatial, cell):
    torch.manual_seed(0)
    net = net_of(make_line(spatial, cell=cell))
    counts = [12, 12, 12]
    batch = {"graph": make_batch(counts), "pointnet2": make_sets(counts), "image": ImageBatch(IMAGE)}[KIND[spatial]]
    dt_s = torch.full((1, 3), 0.1)
    windows = torch.tensor([[0, 1, 2]])
    with torch.autocast("cpu", dtype=torch.bfloat16):
        mixed = net(batch, windows, dt_s)
        mixed.sum().backward()
    assert mixed.dtype == torch.float32
    assert all(parameter.grad.isfinite().all() for parameter in net.parameters())
    torch.testing.assert_close(mixed, net(batch, windows, dt_s), rtol=0, atol=0.1)


@pytest.mark.parametrize(
    ("networks", "wrong", "message"),
    [
        ({}, {"spatial": "gru"}, "^spatial = 'gru' .*cnn, edgeconv, gatv2, gnn, pointnet2"),
        ({}, {"spatial": "gatv"}, "^spatial = 'gatv' .*did you mean gatv2"),
        ({}, {"temporal": "gru"}, "^temporal = 'gru' .*lstm, ncp"),
        ({}, {"cell": "cfcc"}, "^cell = 'cfcc' .*cfc, eq4, ltc.*did you mean cfc"),
        ({}, {"cell": 4}, "^cell = 4: .*string"),
        (
            {},
            {"width": 0.5},
            "^width = 0.5 .*nothing to spatial: gnn with temporal: ncp.*layers, semantics, cell, wiri",
        ),
        ({}, {"units": 7}, "^units = 7 .*nothing to .*: leave it out"),
        (
            {"temporal": "lstm"},
            {"cell": "ltc"},
            "^cell = 'ltc' .*temporal: lstm, which take layers, semantics, units: ",
        ),
        ({"temporal": "lstm"}, {"wiring": {"inter": 3}}, "^wiring means nothing to"),
        ({}, {"semantic": 1.0}, "^semantic = 1.0 .*did you mean semantics"),
        ({}, {"equivarient": True}, "^equivarient = True .*did you mean equivariant"),
        ({}, {"semantics": 1.5}, "^semantics = 1.5: .*less than or equal to 1"),
        ({}, {"semantics": float("nan")}, "^semantics = nan: "),
        ({}, {"layers": []}, r"^layers = \[\]: .*at least 1"),
        ({}, {"layers": [8, 0]}, "^layers.1 = 0: "),
        ({"spatial": "pointnet2"}, {"width": 5}, "^width = 5: .*less than or equal to 4"),
        ({"spatial": "cnn"}, {"features": 30}, "^features = 30: .*multiple of 8"),
        ({"temporal": "lstm"}, {"units": "many"}, "^units = 'many': "),
        ({}, {"wiring": {"comand": 5}}, "^wiring.comand = 5: .*did you mean command"),
        ({}, {"wiring": {"inter": 0}}, "^wiring.inter = 0: "),
        ({}, {"wiring": {"motor_fanin": 7}}, "^wiring.motor_fanin = 7, but .*command = 6"),
        ({}, {"wiring": 3}, "^wiring = 3: "),
    ],
)
def test_what_means_nothing_is_refused_by_its_key(make_line, networks, wrong, message):
    with pytest.raises(ValueError, match=message) as refusal:
        net_of(make_line(**networks) | wrong)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("temporal", names("temporal"))
@pytest.mark.parametrize("spatial", KIND)
def test_a_resolved_line_says_all_and_builds_the_same(make_line, spatial, temporal):
    line = make_line(spatial, temporal)
    whole = resolved(line)
    assert {*steering_net.knobs(line), *line} == {*whole}
    assert json.loads(json.dumps(whole)) == whole == resolved(whole)
    assert line.items() <= {**whole, "wiring": line.get("wiring")}.items()
    weights = []
    for settings in (line, whole):
        torch.manual_seed(0)
        weights.append(net_of(settings).state_dict())
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])


def test_defaults_stand_in_a_resolved_line(make_line):
    whole = resolved({"spatial": "gnn", "temporal": "ncp", "wiring": {"inter": 10}})
    assert (whole["layers"], whole["semantics"], whole["cell"]) == ([32, 32, 64], 0.0, "ltc")
    assert (whole["wiring"]["inter"], whole["wiring"]["command"]) == (10, 6)


def test_the_files_that_a_line_names(make_line):
    assert steering_net.modules(make_line("gatv2", cell="cfc")) == [
        "models.steering.spatial.gatv2", "models.steering.temporal.ncp", "models.steering.core.cell.cfc"
    ]  # fmt: skip
    assert steering_net.modules(make_line("cnn", "lstm"))[1:] == ["models.steering.temporal.lstm"]


def test_a_lines_general_settings_are_those_of_its_section():
    assert set(GENERAL) == set(Model.model_fields)


def test_what_a_newcomer_reads_first_fits_a_screen():
    assert len(inspect.getdoc(steering_net).splitlines()) <= 20


def test_parameter_count_of_the_default_line():
    line = {"spatial": "gnn", "temporal": "ncp", "window": 8, "features": 32, "equivariant": False}
    spatial = (25 + 1) * 32 + (32 + 1) * 32 + (32 + 1) * 64 + (128 + 1) * 32
    assert parameter_count(build(line)) == spatial + 4 * (32 * 6 + 60) + 3 * 19 + 2 * 32 + 2
    assert parameter_count(build({**line, "cell": "eq4"})) == spatial + (32 * 6 + 60) + 19 + 32 * 19 + 2
    layers = [(32, 12, 32 * 6), (12, 6, 12 * 4), (6, 1, 6)]  # heard, neurons, synapses between
    cfc = sum(2 * (synapses + own**2) + 2 * (heard + own) * own + 4 * own for heard, own, synapses in layers)
    assert parameter_count(build({**line, "cell": "cfc"})) == spatial + cfc + 2
    assert parameter_count(build({**line, "temporal": "lstm"})) == spatial + 4 * 32 * (32 + 32 + 2) + 33
