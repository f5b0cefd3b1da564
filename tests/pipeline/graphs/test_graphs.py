"""Test kNN graphs and graph files."""

import json
from collections.abc import Sequence
from pathlib import Path

import h5py
import hdf5plugin
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from pipeline.base.errors import InputError
from pipeline.clouds.cloud import Cloud
from pipeline.clouds.columns import SOURCES, FurtherColumn, check_column
from pipeline.graphs import frame_graph, graph, graph_file
from pipeline.graphs.graph_file import open_graphs
from pipeline.graphs.settings import Variant
from tests import artefacts
from tests.models.steering.frames import concatenated


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 120), st.integers(0, 8), st.sampled_from([0.0, 0.2, 1.0]), st.integers(0, 2**16)
)
def test_a_graph_is_the_symmetric_knn_graph_pruned_between_classes(count, k, keep, seed):
    """Paper Fig. 3: directed edges are counted, 600 for 100 points."""
    xyz, cls = artefacts.points(count, seed)
    edges = graph.undirected(graph.nearest_neighbours(xyz, k))
    pruned = graph.prune(edges, cls, keep, np.random.default_rng(seed))
    rows = np.split(pruned.indices.astype(int), np.cumsum(pruned.degree)[:-1])
    kept = {(i, int(j)) for i, row in enumerate(rows) for j in row}

    # The same edges by a k-d tree, whose first neighbour is the point itself.
    directed = set()
    if count > 1 and k:
        _, neighbours = cKDTree(xyz).query(xyz, range(2, min(k, count - 1) + 2))
        directed = {(i, int(j)) for i, row in enumerate(neighbours) for j in row}
    unpruned = directed | {(j, i) for i, j in directed}
    within = {(i, j) for i, j in unpruned if cls[i] == cls[j]}
    assert within <= kept <= unpruned
    assert {(j, i) for i, j in kept} == kept
    assert len(kept - within) == 2 * round(keep * len(unpruned - within) / 2)
    assert pruned.edges_knn == len(directed)
    assert pruned.edges_kept == len(directed & kept)
    assert all((np.diff(row) > 0).all() for row in rows)  # ascending, and each neighbour once


def test_a_hub_of_more_than_255_neighbours_is_refused():
    # The first point's neighbour is the second; the neighbour of all others is the first.
    hub = graph.undirected(np.eye(257, 1, dtype=np.int32))
    with pytest.raises(InputError, match="256 neighbours"):
        graph.prune(hub, np.zeros(257, np.uint8), 1.0, np.random.default_rng(0))


def write_schema_7(path: Path, clouds: Sequence[Cloud]) -> None:
    """Write clouds as before schema 8, with texts of variable length and without checksums."""
    counts = [len(cloud) for cloud in clouds]
    with h5py.File(path, "w", libver="v110") as file:
        file.attrs.update({"schema": 7, "stage": "clouds", "drive": path.stem})
        file.attrs["params"] = json.dumps({"clouds": {"seed": 3}})
        file["frame"] = np.arange(len(clouds), dtype=np.int32)
        file["time_s"] = np.arange(len(clouds)) / 10
        file["ptr"] = np.cumsum([0, *counts])
        for name in ("xyz", "cls"):
            rows = np.concatenate([getattr(cloud, name) for cloud in clouds])
            file.create_dataset(name, data=rows, chunks=rows.shape, **hdf5plugin.Blosc())
            file[name].attrs["pointer"] = "ptr"
        for dataset in file.values():
            dataset.attrs["unit"] = "m"


def test_clouds_of_schema_7_still_make_graphs(tmp_path):
    path = tmp_path / "drive.h5"
    clouds = [Cloud.from_arrays(*artefacts.points(100, seed)) for seed in range(3)]
    write_schema_7(path, clouds)
    variant = Variant(source="clouds/pseudo", points=100, k=6)
    frame_graph.graphs_drive(tmp_path / "graphs.h5", path, variant)
    with graph_file.open_graphs(tmp_path / "graphs.h5") as graphs:
        assert graphs.params["clouds"] == {"seed": 3}
        for row, cloud in enumerate(clouds):
            expected = frame_graph.build_frame(cloud, variant, "drive", row)
            for name in ("xyz", "degree", "indices"):
                np.testing.assert_array_equal(graphs.rows_of(name, row), expected[name].rows)

    other = Variant(source="clouds/lidar", points=100, columns=["intensity"])
    problem = r"has no column 'intensity' \(it has none\). Add it to clouds.columns, and make"
    with pytest.raises(InputError, match=problem):
        frame_graph.graphs_drive(tmp_path / "graphs.h5", path, other)


def test_graphs_of_schema_8_are_still_read(tmp_path):
    """They also have the measured motion."""
    batches = []
    for name in ("new", "old"):
        path = tmp_path / f"{name}.h5"
        artefacts.write_graphs(path, np.linspace(-0.1, 0.1, 9), np.arange(9), 50)
        if name == "old":
            with h5py.File(path, "r+") as file:
                file.attrs["schema"] = 8
                for column in ("yaw_rate_radps", "speed_mps", "valid"):
                    file[f"motion_{column}"] = np.ones(9, np.float32)
        with open_graphs(path) as graphs:
            batches.append(artefacts.collate((graphs, 2, 7)))
    new, old = batches
    assert new.keys() == old.keys()
    for name, values in new.items():
        np.testing.assert_array_equal(values, old[name])


@pytest.mark.parametrize("kind", [*artefacts.VARIANTS, "image"])
def test_a_batch_is_its_frames_with_shifted_numbers(tmp_path, monkeypatch, kind):
    """Its arrays have the signs of further columns, which take no name of another array."""
    path = tmp_path / "drive.h5"
    artefacts.write_graphs(path, np.linspace(-0.1, 0.1, 9), np.arange(9), 50, kind)
    spans = [(2, 6), (8, 9), (0, 3)]
    rows = [2, 3, 4, 5, 8, 0, 1, 2]

    def read_frame(row: int) -> dict[str, np.ndarray]:
        return {name: file.rows_of(name, row) for name in file.pointers}

    with graph_file.open_graphs(path) as graphs, open_graphs(path) as file:
        batch = artefacts.collate(*((graphs, *span) for span in spans))
        expected = concatenated([read_frame(row) for row in rows])
        signs = {f"{name}_signs": np.float32(values) for name, values in file.signs.items()}
    assert {*signs} == ({"offset_m_signs", "colour_signs"} if kind == "columns" else set())
    expected |= signs
    assert batch.keys() == expected.keys()
    for name in batch.keys() - {"offset_m", "colour"}:
        monkeypatch.setitem(SOURCES["pseudo"], name, FurtherColumn(np.array, (1,), ""))
        with pytest.raises(InputError, match=f"cannot have the name '{name}'"):
            check_column(name)
    for name, array in expected.items():
        np.testing.assert_array_equal(batch[name], array)
        assert batch[name].dtype == (np.int32 if name == "indices" else array.dtype)
