"""Each row of `make bench` runs on small inputs, and both sides of a row compute the same."""

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import bench, graphs, networks
from benchmarks import street as measuring
from benchmarks.street import FRAMES, Street, recorded
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


@pytest.mark.parametrize("name", bench.STREET_ROWS)
def test_a_row_measures_graphs_of_the_given_size(street: Street, name: str) -> None:
    assert f"{POINTS} points" in bench.STREET_ROWS[name](street).what


def test_the_row_of_the_recurrent_network_has_windows_that_share_frames() -> None:
    assert networks.ltc().what.startswith(f"{FRAMES - 7} windows of 8 frames")


def test_a_row_has_medians_of_turns_and_the_factor_by_which_this_project_is_better(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(measuring, "ROUNDS", 3)
    turns: list[str] = []

    def side(name: str, *results: float) -> Callable[[], float]:
        remaining = iter(results)

        def measure() -> float:
            turns.append(name)
            return next(remaining)

        return measure

    row = measuring.compare(side("ours", 99, 1, 9, 2), side("other", 99, 8, 4, 7), "ms", "")
    assert (row.ours, row.alternative, row.ratio) == (2, 7, 3.5)
    assert turns == ["ours", "other"] * 4  # the first turn warms up
    assert measuring.row(8, 2, "windows/s", "").ratio == 4


def test_alternatives_find_the_same_neighbours(street: Street) -> None:
    ((xyz, _),) = street.clouds(1)
    expected = np.sort(graph.nearest(xyz, 6))
    np.testing.assert_array_equal(np.sort(graphs.scipy_neighbours(xyz, 6)), expected)
    np.testing.assert_array_equal(np.sort(graphs.open3d_neighbours(xyz, 6)), expected)


def test_frames_saved_for_pyg_hold_the_same_graph(street: Street, tmp_path: Path) -> None:
    for path, frame in zip(graphs.save(street, tmp_path, 2), street.batch(2).blocks(1), strict=True):
        data = torch.load(path, weights_only=False)
        torch.testing.assert_close(data.pos, frame.xyz, rtol=0, atol=0)
        torch.testing.assert_close(data.edge_index[1], frame.indices.long(), rtol=0, atol=0)
        torch.testing.assert_close(data.edge_index[0].bincount(), frame.degree.long(), rtol=0, atol=0)


def test_pyg_layers_compute_the_same(street: Street) -> None:
    torch.manual_seed(0)
    net, batch = GCN(1), street.batch(3)
    expected = networks.pooled(networks.pyg_layers(net), networks.normalised(batch), batch)
    torch.testing.assert_close(net.pooled(batch, 1)[:, 0], expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("keep", [0.0, 1.0])
def test_pyg_builds_the_same_graph(keep: float) -> None:
    rng = np.random.default_rng(0)
    xyz, cls = rng.normal(size=(300, 3)).astype(np.float32), rng.integers(0, 3, 300).astype(np.uint8)
    ours = graph.build(xyz, cls, 6, keep, rng)
    ptr, indices = graphs.pyg_graph(xyz, cls, 6, keep, rng)
    np.testing.assert_array_equal(ptr.diff().numpy(), ours.degree)
    np.testing.assert_array_equal(indices.numpy(), ours.indices)
