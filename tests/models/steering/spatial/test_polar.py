import math

import pytest
import torch

from models.steering.core.batch import GraphBatch
from models.steering.core.options import Sizes
from models.steering.spatial.polar import BEARINGS, FAR_M, NEAR_M, RANGES, Options, polar_map
from pipeline.camera import classes

TOLERANCE = {"rtol": 0, "atol": 1e-9}
UNEQUAL = [300, 0, 1, 170]


@pytest.fixture
def network():
    torch.manual_seed(0)
    return Options(widths=(6, 8, 8)).build(Sizes(5)).double()


def points_of(batch: GraphBatch, frame: int) -> GraphBatch:
    rows = slice(*batch.ptr[frame : frame + 2].tolist())
    xyz, cls = batch.xyz[rows], batch.cls[rows]
    return GraphBatch(xyz, cls, torch.tensor([0, len(cls)]), torch.zeros(len(cls)), torch.zeros(0))


def brute_force(batch: GraphBatch) -> torch.Tensor:
    """The map of one frame, cell by cell."""
    rows = zip(batch.xyz.tolist(), batch.cls.tolist(), strict=True)
    points = [(math.hypot(x, z), math.degrees(math.atan2(x, z)), c) for (x, _, z), c in rows]
    edges = [NEAR_M * (FAR_M / NEAR_M) ** (number / RANGES) for number in range(RANGES + 1)]
    width = 90 / BEARINGS
    result = torch.zeros(4, RANGES, BEARINGS)
    for row in range(RANGES):
        for column in range(BEARINGS):
            middle = (column - BEARINGS // 2) * width
            cell = [c for r, b, c in points if edges[row] <= r < edges[row + 1] and abs(b - middle) < width / 2]
            known = [c for c in cell if c != classes.VOID]
            kinds = [["ground" if c in classes.GROUND else "obstacle", "road"][c == classes.ROAD] for c in known]
            for channel, kind in enumerate(["road", "ground", "obstacle"]):
                result[channel, row, column] = kinds.count(kind) / max(1, len(cell))
            result[3, row, column] = not cell
    return result


def test_map_equals_brute_force(make_batch):
    batch = make_batch(UNEQUAL)
    frames = polar_map(batch)
    assert frames.shape == (4, 4, RANGES, BEARINGS)
    torch.testing.assert_close(frames, torch.stack([brute_force(points_of(batch, frame)) for frame in range(4)]))
    assert frames[1, 3].all()  # the empty frame is unseen
    assert not frames[1, :3].any()
    for channel in range(3):
        assert frames[:, channel].any()


def test_mirroring_reverses_the_bearings_exactly(make_batch):
    """Also of points straight ahead and on the border of two cells."""
    batch = make_batch([400])
    border = math.tan(math.radians(90 / BEARINGS / 2))
    batch.xyz[:40, 0] = 0
    batch.xyz[40:80, 0] = batch.xyz[40:80, 2] * border
    for dtype in (torch.float32, torch.float64):
        points = GraphBatch(batch.xyz.to(dtype), *list(vars(batch).values())[1:])
        assert torch.equal(polar_map(points.mirrored()), polar_map(points).flip(3))


def test_points_outside_and_their_order_change_nothing(make_batch, network):
    batch = make_batch([200])
    order = torch.randperm(200)
    outside = torch.tensor([[0.0, 0, 3.9], [0, 0, 40.1], [9, 0, 8.5], [0, 0, -10], [0, 0, 0]], dtype=torch.float64)
    xyz, cls = torch.cat([batch.xyz[order], outside]), torch.cat([batch.cls[order], batch.cls[:5]])
    more = GraphBatch(xyz, cls, torch.tensor([0, 205]), batch.degree, batch.indices)
    assert torch.equal(polar_map(more), polar_map(batch))
    assert torch.equal(network(more), network(batch))


def test_batch_equals_single_frames(make_batch, network):
    batch = make_batch(UNEQUAL)
    singles = torch.cat([network(points_of(batch, frame)) for frame in range(4)])
    torch.testing.assert_close(network(batch), singles, **TOLERANCE)
    torch.testing.assert_close(network.both(batch), (network(batch), network(batch.mirrored())), **TOLERANCE)


def test_all_weights_learn(make_batch, network):
    network(make_batch(UNEQUAL)).square().sum().backward()
    assert all(parameter.grad is not None and parameter.grad.any() for parameter in network.parameters())


def test_size_is_as_documented():
    assert 25_000 < sum(parameter.numel() for parameter in Options().build(Sizes(32)).parameters()) < 35_000
