"""Networks of each combination: shared frames, mirroring, motion, mixed precision."""

import json
import pickle

import pytest
import torch

from models.steering.core.batch import GraphBatch, ImageBatch
from models.steering.core.options import load, names
from models.steering.core.steering_net import MOTION_MIRROR_SIGNS, SteeringNet, odd_and_even
from models.steering.temporal.ncp import CELLS
from pipeline.settings.models import Entry

TOLERANCE = {"rtol": 0, "atol": 1e-9}
WINDOWS = torch.tensor([[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]])
KIND = {name: load("spatial", name).kind for name in names("spatial") if name != "blind"}  # blind has no input
RECURRENT = [("lstm", {}), *(("ncp", {"cell": name}) for name in CELLS)]
COUNTS = [20, 9, 30, 12, 1, 25]  # points per frame
IMAGE = torch.randint(0, 256, (6, 32, 40, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
MOTION = torch.rand(6, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * torch.tensor(
    [0.2, 0.5, 20, 1]
)
CONTENTS = {"graph": {}, "pointnet2": {"levels": 2}, "image": {"image_size": (32, 40)}}


def build_any(line: dict[str, object]) -> SteeringNet:
    """Build the network of an entry with an input of its kind."""
    torch.manual_seed(0)
    kind = KIND.get(line["spatial"], "graph")
    return Entry.model_validate(line).build(kind, **CONTENTS[kind])


@pytest.fixture
def frames(make_batch, make_sets):
    """frames(spatial) → a batch of six frames for this network."""
    return lambda spatial: {
        "graph": lambda: make_batch(COUNTS), "pointnet2": lambda: make_sets(COUNTS), "image": lambda: ImageBatch(IMAGE)
    }[KIND[spatial]]()  # fmt: skip


def test_a_wrong_number_of_features_is_named_with_the_network(make_batch, dt_s):
    net = build_any({"input": "x", "spatial": "gnn", "temporal": "lstm", "semantics": 0.0})
    net.spatial = torch.nn.Sequential(net.spatial, torch.nn.Linear(32, 20))
    expected = (
        r"models/steering/spatial/gnn\.py: the spatial network returns \[6, 20\] for 6 frames, expected \[6, 32\]"
    )
    with pytest.raises(ValueError, match=expected):
        net(make_batch(COUNTS), WINDOWS, dt_s)


@pytest.fixture
def dt_s():
    return torch.rand(WINDOWS.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(2)) * 0.1 + 0.05


def select(batch: GraphBatch, frames: list[int]) -> GraphBatch:
    """Return the batch of these frames, in this order, built by hand."""
    edge_ptr = torch.cat([torch.zeros(1, dtype=torch.int64), batch.degree.long().cumsum(0)])[batch.ptr]
    pieces, start = [], 0
    for frame in frames:
        rows = slice(batch.ptr[frame], batch.ptr[frame + 1])
        indices = batch.indices[edge_ptr[frame] : edge_ptr[frame + 1]] - batch.ptr[frame] + start
        pieces.append((batch.xyz[rows], batch.cls[rows], batch.degree[rows], indices))
        start += len(pieces[-1][0])
    xyz, cls, degree, indices = (torch.cat(column) for column in zip(*pieces, strict=True))
    return GraphBatch(xyz, cls, torch.tensor([0, *(len(piece[0]) for piece in pieces)]).cumsum(0), degree, indices)


@pytest.mark.parametrize(("temporal", "options"), RECURRENT)
@pytest.mark.parametrize("spatial", [name for name in KIND if KIND[name] == "graph"])
def test_shared_frames_equal_naive_windows(make_batch, make_line, dt_s, spatial, temporal, options):
    net = build_any(make_line(spatial, temporal, **options)).double()
    batch = make_batch([9, 12, 7, 9, 0, 20])

    def loss_and_gradients(predictions):
        loss = (predictions - torch.arange(3)).square().mean()
        return loss, torch.autograd.grad(loss, list(net.parameters()))

    shared = net(batch, WINDOWS, dt_s)
    own = torch.arange(4)[None]
    naive = torch.cat([net(select(batch, window.tolist()), own, dt_s[w : w + 1]) for w, window in enumerate(WINDOWS)])
    torch.testing.assert_close(shared, naive, **TOLERANCE)
    loss, gradients = loss_and_gradients(shared)
    torch.testing.assert_close((loss, gradients), loss_and_gradients(naive), **TOLERANCE)
    assert all(gradient.abs().sum() > 0 for gradient in gradients)


@pytest.mark.parametrize("spatial", [name for name in KIND if KIND[name] != "graph"])
def test_shared_sets_and_images_equal_single_ones(make_sets, make_line, frames, dt_s, spatial):
    net = build_any(make_line(spatial)).double()
    shared = net(frames(spatial), WINDOWS, dt_s)
    sets = KIND[spatial] == "pointnet2"
    singles = [make_sets(COUNTS, only=n) if sets else ImageBatch(IMAGE[n : n + 1]) for n in range(6)]
    features = torch.cat([net.encode(frame) for frame in singles])
    torch.testing.assert_close(shared, net.run_windows(features, WINDOWS, dt_s), **TOLERANCE)
    gradients = torch.autograd.grad(shared.square().sum(), list(net.parameters()))
    assert all(gradient.abs().sum() > 0 for gradient in gradients)


@pytest.mark.parametrize(("temporal", "options"), RECURRENT)
@pytest.mark.parametrize("spatial", KIND)
def test_mirrored_input_negates_an_equivariant_network(make_line, frames, dt_s, spatial, temporal, options):
    batch, signs = frames(spatial), torch.tensor([-1, -1, 1, 1])
    for motion, steered in ((None, None), (MOTION.clone().requires_grad_(), MOTION * signs)):
        kind = "none" if motion is None else "visual"
        net = build_any(make_line(spatial, temporal, motion=kind, equivariant=True, **options)).double()
        output = net(batch, WINDOWS, dt_s, motion)
        torch.testing.assert_close(net(batch.mirrored(), WINDOWS, dt_s, steered), -output, **TOLERANCE)
        assert output.abs().min() > 1e-6
        pairs = net(batch, WINDOWS, dt_s, motion, pairs=True)
        torch.testing.assert_close(pairs, torch.cat([output, -output]), **TOLERANCE)
    (gradient,) = torch.autograd.grad(output.square().sum(), motion)
    assert (gradient.abs() > 0).all()
    plain = build_any(make_line(spatial, temporal, motion="visual", **options)).double()
    sides = plain(batch, WINDOWS, dt_s, MOTION), plain(batch.mirrored(), WINDOWS, dt_s, MOTION * signs)
    assert (sides[0] + sides[1]).abs().max() > 1e-6
    torch.testing.assert_close(plain(batch, WINDOWS, dt_s, MOTION, pairs=True), torch.cat(sides), **TOLERANCE)


@pytest.mark.parametrize(("temporal", "options"), RECURRENT)
def test_a_mirrored_scene_has_the_same_uncertainty(make_line, frames, dt_s, temporal, options):
    batch, signs = frames("gnn"), torch.tensor([-1.0, 1.0], dtype=torch.float64)
    net = build_any(make_line("gnn", temporal, equivariant=True, uncertainty=True, **options)).double()
    output = net(batch, WINDOWS, dt_s)
    assert output.shape == (3, 2)
    torch.testing.assert_close(net(batch.mirrored(), WINDOWS, dt_s), output * signs, **TOLERANCE)
    pairs = net(batch, WINDOWS, dt_s, pairs=True)
    torch.testing.assert_close(pairs, torch.cat([output, output * signs]), **TOLERANCE)
    plain = build_any(make_line("gnn", temporal, uncertainty=True, **options)).double()
    sides = torch.cat([plain(each, WINDOWS, dt_s) for each in (batch, batch.mirrored())])
    torch.testing.assert_close(plain(batch, WINDOWS, dt_s, pairs=True), sides, **TOLERANCE)


@pytest.mark.parametrize(("temporal", "expected"), [("ncp", 0.7463194025667146), ("lstm", 0.26132779169831866)])
def test_a_seed_gives_the_same_numbers_in_all_versions(make_batch, make_line, temporal, expected):
    batch, dt_s = make_batch([9, 12, 7, 9, 5, 20]), torch.full(WINDOWS.shape, 0.1, dtype=torch.float64)
    torch.manual_seed(3)
    net = Entry.model_validate(make_line("gnn", temporal)).build("graph").double()
    # Initial weights are drawn in float32, whose logarithms differ between CPUs in the last bit.
    assert net(batch, WINDOWS, dt_s)[0].item() == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("spatial", KIND)
def test_mixed_precision_keeps_the_recursion_in_float32(make_line, frames, spatial, cell):
    net = build_any(make_line(spatial, cell=cell))
    arguments = (frames(spatial), WINDOWS[:1], torch.full((1, 4), 0.1))
    with torch.autocast("cpu", dtype=torch.bfloat16):
        mixed = net(*arguments)
        mixed.sum().backward()
    assert mixed.dtype == torch.float32
    assert all(parameter.grad.isfinite().all() for parameter in net.parameters())
    torch.testing.assert_close(mixed, net(*arguments), rtol=0, atol=0.1)


@pytest.mark.parametrize("temporal", names("temporal"))
@pytest.mark.parametrize("spatial", KIND)
def test_an_entry_is_complete_and_survives_json_and_pickle(make_line, spatial, temporal):
    entry = Entry.model_validate(make_line(spatial, temporal))
    dumped = entry.model_dump(mode="json")
    for copy in (Entry.model_validate(json.loads(json.dumps(dumped))), pickle.loads(pickle.dumps(entry))):
        assert copy == entry
        assert copy.model_dump(mode="json") == dumped
    assert {*load("spatial", spatial).model_fields, *load("temporal", temporal).model_fields} <= dumped.keys()


def test_columns_are_of_order_one_and_the_odd_ones_are_odd():
    corner, motorway = [0.5, 0.6, 4.0, 1.0], [-0.01, -0.1, 36.0, 1.0]
    motion = torch.tensor([corner, motorway, [0.0] * 4, [-1.5, 0.0, 0.1, 0.0]])
    odd, even = odd_and_even(motion)
    assert odd.abs().max() <= 1 < even.max() < 3
    assert odd[0].min() > 0.8
    assert not torch.cat([odd[2], even[2]]).any()
    there, same = odd_and_even(motion * torch.tensor(MOTION_MIRROR_SIGNS))
    assert torch.equal(there, -odd)
    assert torch.equal(same, even)


@pytest.mark.parametrize("name", ["../temporal/lstm", "..core.wiring", "__init__", "gnn.py", "", "os"])
def test_only_files_of_the_folder_are_imported(name: str) -> None:
    with pytest.raises(ValueError, match=r"^spatial = .*known: blind, cnn, edgeconv, gatv2, gnn, pointnet2, polar\)"):
        load("spatial", name)
    assert name not in names("spatial")


@pytest.mark.parametrize(("temporal", "options"), RECURRENT)
@pytest.mark.parametrize("equivariant", [False, True])
def test_a_path_has_an_output_per_range_and_mirrors(
    temporal: str, options: dict[str, object], equivariant: bool, make_line, make_batch, dt_s
) -> None:
    line = make_line("gnn", temporal, predict="path", motion="visual", equivariant=equivariant, **options)
    torch.manual_seed(0)
    net = Entry.model_validate(line).build("graph", outputs=3).double()
    batch = make_batch(COUNTS)
    out = net(batch, WINDOWS, dt_s, MOTION, pairs=True)
    assert out.shape == (2 * len(WINDOWS), 3)
    assert len(torch.unique(out.detach().round(decimals=6))) > 3
    mirrored = net(batch.mirrored(), WINDOWS, dt_s, MOTION * torch.tensor(MOTION_MIRROR_SIGNS))
    torch.testing.assert_close(out[len(WINDOWS) :], mirrored, **TOLERANCE)
    if equivariant:
        torch.testing.assert_close(out[: len(WINDOWS)], -mirrored, **TOLERANCE)
