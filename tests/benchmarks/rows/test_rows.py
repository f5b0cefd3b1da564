"""Every row at a thousandth of its size: it runs, and its two sides do the same."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.rows import at_hand, building, files, graph_network, recurrent, row, sets, steps
from benchmarks.rows.at_hand import FRAMES, Street
from models.steering.spatial.gnn import GCN
from pipeline.base import store
from pipeline.graphs import cloud, graph
from tests.artefacts import bend, write_labels

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    import ncps.torch  # noqa: F401
    import torch_geometric.nn  # noqa: F401

DRIVE, POINTS = "2026_01_01_drive_0001", 150


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What ``make demo`` leaves of a drive."""
    data, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(0)
    frame, steering_rad = np.arange(FRAMES + 2), np.linspace(-0.2, 0.2, FRAMES + 2)
    clouds = [cloud.ordered(bend(angle, POINTS, rng)) for angle in steering_rad]
    with store.DriveWriter(data / f"clouds/pseudo/{DRIVE}.h5", stage="clouds", drive=DRIVE, params={}) as file:
        cloud.write(file, frame, frame * 0.1, clouds)
    store.write_index(data / "clouds/pseudo", {DRIVE: "train"})
    write_labels(data / f"labels/{DRIVE}.h5", DRIVE, steering_rad, frame)
    return data


@pytest.fixture(scope="module")
def street(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Street:
    return at_hand.sample(data, tmp_path_factory.mktemp("street"), POINTS)


@pytest.fixture(autouse=True)
def once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(row, "ROUNDS", 1)
    monkeypatch.setattr(recurrent, "TIMES", 1)


def test_a_ratio_above_one_is_in_our_favour() -> None:
    assert row.compare(lambda: 2.0, lambda: 6.0, "ms", "").ratio == 3
    assert row.compare(lambda: 6.0, lambda: 2.0, "1/s", "", more_is_better=True).ratio == 3


def test_medians_leave_the_warm_up_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(row, "ROUNDS", 3)
    ours, peer = iter([100.0, 1.0, 9.0, 2.0]), iter([100.0, 4.0, 4.0, 90.0])
    measured = row.compare(lambda: next(ours), lambda: next(peer), "ms", "")
    assert (measured.ours, measured.peer, measured.ratio) == (2, 4, 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "measure",
    [
        graph_network.vs_pyg_edge_index, graph_network.vs_pyg_csr, graph_network.vs_linear,
        steps.equivariant_vs_plain, steps.windows_vs_naive, files.load, sets.pointnet2,
    ],
)  # fmt: skip
def test_a_row_of_a_network(street: Street, measure) -> None:
    of_network(measure(street, "cpu"))


@pytest.mark.slow
@pytest.mark.parametrize("measure", [recurrent.vs_ncps, recurrent.vs_lstm])
def test_a_row_of_a_cell(measure) -> None:
    of_network(measure("cpu"))


@pytest.mark.slow
@pytest.mark.parametrize("measure", [building.graph_build, building.knn_vs_scipy, building.knn_vs_open3d, files.size])
def test_a_row_of_graphs(street: Street, measure) -> None:
    of_network(measure(street))


def of_network(measured: row.Row) -> None:
    assert measured.peer is not None
    assert all(0 < figure < math.inf for figure in (measured.ours, measured.peer, measured.ratio))


@pytest.mark.slow
def test_rows_without_a_peer(street: Street) -> None:
    assert building.graphs_stage_fps(street).ours > 0
    times, peak_bytes = steps.whole_step(street, "cpu", 1)
    assert times > 0
    assert peak_bytes > 50e6  # a process with torch


def test_a_street_has_as_many_frames_as_a_run(street: Street) -> None:
    arrays = street.arrays(FRAMES)
    assert len(arrays["ptr"]) == FRAMES + 1
    assert (np.diff(arrays["ptr"]) == POINTS).all()


def test_pyg_layers_say_what_ours_do(street: Street) -> None:
    from torch_geometric.nn.conv.gcn_conv import gcn_norm

    torch.manual_seed(0)
    net, batch = GCN(1), graph_network.graph_batch(street, 3, "cpu")
    graph_of_peer = gcn_norm(graph_network.edge_index(batch), None, len(batch.xyz))
    layers = [(layer, graph_of_peer) for layer in graph_network.pyg_like(net)]
    torch.testing.assert_close(graph_network._through(layers, batch), net.pooled(batch), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("keep", [0.0, 1.0])
def test_the_peer_builds_the_same_graph(keep: float) -> None:
    rng = np.random.default_rng(0)
    xyz, cls = rng.normal(size=(300, 3)).astype(np.float32), rng.integers(0, 3, 300).astype(np.uint8)
    ours = graph.build(xyz, cls, 6, keep, rng)
    ptr, indices = building.by_pyg(xyz, cls, 6, keep, rng)
    np.testing.assert_array_equal(ptr.diff().numpy(), ours.degree)
    np.testing.assert_array_equal(indices.numpy(), ours.indices)


def test_data_of_pyg_holds_the_same_frames(street: Street) -> None:
    batch = graph_network.graph_batch(street, 2, "cpu")
    first, second = files.as_data(batch)
    assert torch.equal(torch.cat([first.pos, second.pos]), batch.xyz)
    both = torch.cat([first.edge_index, second.edge_index + len(first.pos)], dim=1)
    assert torch.equal(both, graph_network.edge_index(batch))


def test_what_stands_on_the_road_is_of_one_class_per_column() -> None:
    xyz = np.array([[1, 1.6, 5], [1, 0, 5], [2, -1, 6], [9, 0, 5]], np.float32)
    cls = at_hand.classes_of(xyz)
    assert cls[0] == 0
    assert cls[1] == cls[2] != 0
    assert cls.dtype == np.uint8
