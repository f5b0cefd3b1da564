"""Runs of frames of each kind equal the file, frame by frame."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

from models.steering.core.batch import GraphBatch, from_arrays
from models.steering.core.features import node_features
from models.steering.spatial import gnn
from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.train import frames
from tests import artefacts

FRAMES = 9
RUNS = [(2, 6), (8, 9), (0, 3)]
ROWS = [row for run in RUNS for row in range(*run)]
KINDS = {"graph": artefacts.write_graphs, "pointnet2": artefacts.write_sets, "image": artefacts.write_images}


def write_file(folder: Path, write: Callable[..., None]) -> Path:
    write(folder / "drive.h5", "drive", np.linspace(-0.1, 0.1, FRAMES), np.arange(FRAMES), 50, np.random.default_rng(0))
    return folder / "drive.h5"


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {kind: write_file(tmp_path_factory.mktemp(kind), write) for kind, write in KINDS.items()}


def read(path: Path, runs: list[tuple[int, int]]) -> frames.Arrays:
    with frames.open_graphs(str(path)) as graphs:
        return frames.concatenate([graphs.read(*run) for run in runs])


def test_row_numbers_refer_to_the_same_points_in_file_and_batch(paths: dict[str, Path]) -> None:
    batch = read(paths["pointnet2"], RUNS)
    names = {"xyz", "cls", "ptr", "centres_1", "neighbours_1", "centres_1_ptr"}
    assert set(batch) == names | {"centres_2", "neighbours_2", "centres_2_ptr"}
    with store.DriveReader(paths["pointnet2"], stage="graphs") as file:
        stored = {name: file[name] for name in batch}

    def of_frame(arrays: frames.Arrays, name: str, frame: int) -> np.ndarray:
        ptr = arrays["ptr" if name in ("xyz", "cls") else f"centres_{name[-1]}_ptr"]
        return arrays[name][ptr[frame] : ptr[frame + 1]]

    for number, row in enumerate(ROWS):
        xyz = of_frame(stored, "xyz", row)
        assert (of_frame(batch, "xyz", number) == xyz).all()
        assert (of_frame(batch, "cls", number) == of_frame(stored, "cls", row)).all()
        for name in ("centres_1", "neighbours_1"):
            assert (batch["xyz"][of_frame(batch, name, number)] == xyz[of_frame(stored, name, row)]).all()
        first = xyz[of_frame(stored, "centres_1", row)]
        for name in ("centres_2", "neighbours_2"):
            expected = first[of_frame(stored, name, row)]
            assert (batch["xyz"][batch["centres_1"][of_frame(batch, name, number)]] == expected).all()
    assert batch["ptr"][-1] == len(batch["xyz"])
    assert len(batch["ptr"]) == len(batch["centres_2_ptr"]) == 1 + len(ROWS)


def test_edges_connect_the_same_points_in_file_and_batch(paths: dict[str, Path]) -> None:
    batch = read(paths["graph"], RUNS)
    assert set(batch) == {"xyz", "cls", "ptr", "degree", "indices"}
    assert (batch["indices"].dtype, batch["degree"].dtype, batch["xyz"].dtype) == (np.int32, np.uint8, np.float32)
    with store.DriveReader(paths["graph"], stage="graphs") as file:
        ptr, indices_ptr, indices, xyz = (file[name] for name in ("ptr", "indices_ptr", "indices", "xyz"))
    ends = np.concatenate([xyz[ptr[row] + indices[indices_ptr[row] : indices_ptr[row + 1]]] for row in ROWS])
    np.testing.assert_array_equal(batch["xyz"][batch["indices"]], ends)


@pytest.mark.parametrize("kind", ["graph", "pointnet2"])
def test_one_run_equals_its_pieces(paths: dict[str, Path], kind: str) -> None:
    pieces, complete = read(paths[kind], [(0, 4), (4, 5), (5, 9)]), read(paths[kind], [(0, 9)])
    assert all((pieces[name] == complete[name]).all() for name in complete)


@pytest.mark.parametrize(
    ("kind", "name", "value", "words"),
    [
        ("graph", "indices", 50, "indices exceeds the 50 rows"),
        ("graph", "degree", 0, "degree"),
        ("pointnet2", "neighbours_2", 16, "neighbours_2 exceeds the 16 rows"),
    ],
)
def test_inconsistent_graphs_are_refused(tmp_path: Path, kind: str, name: str, value: int, words: str) -> None:
    path = write_file(tmp_path, KINDS[kind])
    with h5py.File(path, "a") as file:
        file[name][0] = value
    with pytest.raises(InputError, match=words) as raised:
        read(path, [(0, 2)])
    assert raised.value.where == str(path)


def test_to_pyg_is_the_graph_that_gcn_sees(paths: dict[str, Path]) -> None:
    """PyTorch Geometric's propagation on it equals ours."""
    gcn = pytest.importorskip("torch_geometric.nn")
    with frames.open_graphs(paths["graph"]) as graphs:
        data, batch = graphs.to_pyg(3, 0.25), from_arrays(graphs.read(3, 4))
        with pytest.raises(InputError, match="no frame 99"):
            graphs.to_pyg(99)
    assert isinstance(batch, GraphBatch)
    assert data.y.tolist() == [0.25]
    assert torch.equal(data.pos, batch.xyz)
    assert data.validate()
    assert not data.is_directed()
    net = gnn.GCNLayer(25, 4)
    peer = gcn.GCNConv(25, 4)
    peer.lin.weight.data, peer.bias.data = net.weight.data.T, net.bias.data
    ours = net(node_features(batch.xyz, batch.cls, 1.0), gnn.GCNLayer.operator(batch, torch.float32))
    torch.testing.assert_close(peer(data.x, data.edge_index), ours, atol=1e-5, rtol=0)
    with frames.open_graphs(paths["image"]) as images, pytest.raises(InputError, match="expected kNN graphs"):
        images.to_pyg(3)
