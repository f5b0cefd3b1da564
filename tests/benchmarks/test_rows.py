"""Test that each row runs on small inputs, and that both of its sides compute the same."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import files, graph_network, neighbours, recurrent, row, training
from benchmarks.street import FRAMES, Street, recorded
from models.steering.spatial.gnn import GCN
from pipeline.base.errors import InputError
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
    monkeypatch.setattr(row, "ROUNDS", 1)
    monkeypatch.setattr(recurrent, "REPEATS", 1)


def test_a_ratio_above_one_means_that_this_project_is_better() -> None:
    assert row.row(2.0, 6.0, "ms", "").ratio == 3
    assert row.row(6.0, 2.0, "1/s", "", higher_is_better=True).ratio == 3


def test_medians_do_not_include_the_warm_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(row, "ROUNDS", 3)
    ours, alternative = iter([100.0, 1.0, 9.0, 2.0]), iter([100.0, 4.0, 4.0, 90.0])
    measured = row.compare(lambda: next(ours), lambda: next(alternative), "ms", "")
    assert (measured.ours, measured.alternative, measured.ratio) == (2, 4, 2)


@pytest.mark.parametrize(
    "measure",
    [
        graph_network.beside_edge_index,
        graph_network.beside_csr,
        training.windows,
        files.load,
        files.size,
        neighbours.graph_build,
        neighbours.beside_scipy,
        neighbours.beside_open3d,
    ],
)
def test_a_row_has_two_sides(street: Street, measure) -> None:
    check(measure(street))


def test_the_row_of_the_recurrent_network_has_two_sides() -> None:
    check(recurrent.ltc())


def check(measured: row.Row) -> None:
    assert measured.alternative is not None
    assert measured.ratio is not None
    assert all(0 < number < math.inf for number in (measured.ours, measured.alternative, measured.ratio))


def test_a_street_has_the_asked_points(street: Street, tmp_path: Path) -> None:
    arrays = street.arrays(FRAMES)
    assert np.diff(arrays["ptr"]).tolist() == [POINTS] * FRAMES
    assert len(np.unique(arrays["cls"])) > 2
    with pytest.raises(InputError):
        recorded(tmp_path, tmp_path)


def test_pyg_layers_compute_the_same(street: Street) -> None:
    torch.manual_seed(0)
    net, batch = GCN(1), street.batch(3)
    expected = graph_network.pooled(graph_network.pyg_layers(net), graph_network.normalised(batch), batch)
    torch.testing.assert_close(net.pooled(batch), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("search", [neighbours.scipy_neighbours, neighbours.open3d_neighbours])
def test_libraries_find_the_same_neighbours(search) -> None:
    xyz = np.random.default_rng(0).normal(size=(300, 3)).astype(np.float32)
    np.testing.assert_array_equal(np.sort(search(xyz, 6)), np.sort(graph.nearest(xyz, 6)))


@pytest.mark.parametrize("keep", [0.0, 1.0])
def test_pyg_builds_the_same_graph(keep: float) -> None:
    rng = np.random.default_rng(0)
    xyz, cls = rng.normal(size=(300, 3)).astype(np.float32), rng.integers(0, 3, 300).astype(np.uint8)
    ours = graph.build(xyz, cls, 6, keep, rng)
    ptr, indices = neighbours.pyg_graph(xyz, cls, 6, keep, rng)
    np.testing.assert_array_equal(ptr.diff().numpy(), ours.degree)
    np.testing.assert_array_equal(indices.numpy(), ours.indices)


def test_pyg_data_holds_the_same_frames(street: Street, tmp_path: Path) -> None:
    batch = street.batch(2)
    first, second = (torch.load(path, weights_only=False) for path in files.save(street, tmp_path, 2))
    assert torch.equal(torch.cat([first.pos, second.pos]), batch.xyz)
    both = torch.cat([first.edge_index, second.edge_index + len(first.pos)], dim=1)
    assert torch.equal(both, graph_network.edge_index(batch))
