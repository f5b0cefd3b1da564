"""Each row of `make bench` runs on small inputs, and PyG computes the same."""

import math
import warnings

import numpy as np
import pytest
import torch

from benchmarks import graphs, networks
from benchmarks import street as measuring
from benchmarks.street import FRAMES, Row, Street, recorded
from models.steering.spatial.gnn import GCN
from pipeline.graphs import graph

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    import ncps.torch  # noqa: F401
    import torch_geometric.nn  # noqa: F401

POINTS = 150


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Street:
    """Graphs of random scans in KITTI's layout."""
    kitti, rng = tmp_path_factory.mktemp("kitti"), np.random.default_rng(0)
    folder = kitti / "2011_09_26/2011_09_26_drive_0001_sync/velodyne_points/data"
    folder.mkdir(parents=True)
    for number in range(FRAMES + 1):
        rng.uniform(-9, 9, (2 * POINTS, 4)).astype(np.float32).tofile(folder / f"{number:010}.bin")
    return recorded(kitti, tmp_path_factory.mktemp("street"), POINTS)


@pytest.fixture(autouse=True)
def measure_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measuring, "ROUNDS", 1)
    monkeypatch.setattr(networks, "REPEATS", 1)


@pytest.mark.parametrize(
    "measure",
    [
        networks.beside_edge_index,
        networks.beside_csr,
        networks.training,
        graphs.load,
        graphs.size,
        graphs.graph_build,
        graphs.beside_scipy,
        graphs.beside_open3d,
    ],
)
def test_a_row_has_two_sides(street: Street, measure) -> None:
    check(measure(street))


def test_the_row_of_the_recurrent_network_has_two_sides() -> None:
    check(networks.ltc())


def check(measured: Row) -> None:
    assert measured.alternative is not None
    assert measured.ratio is not None
    assert all(0 < number < math.inf for number in (measured.ours, measured.alternative, measured.ratio))


def test_pyg_layers_compute_the_same(street: Street) -> None:
    torch.manual_seed(0)
    net, batch = GCN(1), street.batch(3)
    expected = networks.pooled(networks.pyg_layers(net), networks.normalised(batch), batch)
    torch.testing.assert_close(net.pooled(batch), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("keep", [0.0, 1.0])
def test_pyg_builds_the_same_graph(keep: float) -> None:
    rng = np.random.default_rng(0)
    xyz, cls = rng.normal(size=(300, 3)).astype(np.float32), rng.integers(0, 3, 300).astype(np.uint8)
    ours = graph.build(xyz, cls, 6, keep, rng)
    ptr, indices = graphs.pyg_graph(xyz, cls, 6, keep, rng)
    np.testing.assert_array_equal(ptr.diff().numpy(), ours.degree)
    np.testing.assert_array_equal(indices.numpy(), ours.indices)
