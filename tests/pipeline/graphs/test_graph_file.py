"""Graph files of the three kinds: written, read in runs of frames, refused when inconsistent."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.graphs import frame_graph, graph_file
from pipeline.graphs.graph_file import Arrays, open_graphs
from pipeline.settings.graphs import Variant
from tests import artefacts

KNN = Variant(source="clouds/pseudo", points=30, k=4, keep_inter_class=0.5)
SETS = Variant(
    **{"source": "clouds/pseudo", "neighbourhood": "pointnet2", "points": 30},
    **{"centres": [8, 3], "radius_m": [5.0, 9.0], "neighbours": [4, 2]},
)
FRAME, TIME_S = np.array([4, 5, 9]), np.array([0.0, 0.1, 0.5])
FRAMES = 9
RUNS = [(2, 6), (8, 9), (0, 3)]
ROWS = [row for run in RUNS for row in range(*run)]
KINDS = {"graph": artefacts.write_graphs, "pointnet2": artefacts.write_sets, "image": artefacts.write_images}


def frames(variant: Variant) -> list[Arrays]:
    """Return three frames, of 30, 0 and 12 points."""
    rng = np.random.default_rng(0)
    clouds = [(rng.uniform(-9, 9, (n, 3)).astype(np.float32), rng.integers(0, 3, n, np.uint8)) for n in (30, 0, 12)]
    return [frame_graph.connect(cloud, variant, np.random.default_rng(seed)) for seed, cloud in enumerate(clouds)]


def write(path: Path, variant: Variant) -> graph_file.Counts:
    with DriveWriter(path, stage="graphs", drive="drive", params={}) as file:
        return graph_file.write(file, FRAME, TIME_S, frames(variant), frame_graph.empty(variant))


@pytest.mark.parametrize("variant", [KNN, SETS])
def test_the_datasets_of_each_frame(tmp_path: Path, variant: Variant) -> None:
    counts = write(tmp_path / "a.h5", variant)
    assert (counts["frames"], counts["points"]) == (3, 42)
    with DriveReader(tmp_path / "a.h5", stage="graphs") as file:
        assert (file.frame.tolist(), file.frame.dtype, file["ptr"].tolist()) == ([4, 5, 9], np.int32, [0, 30, 30, 42])
        np.testing.assert_array_equal(file.time_s, TIME_S)
        for row, arrays in enumerate(frames(variant)):
            for name, array in arrays.items():
                stored = file.rows_of(name, row) if array.ndim else file[name][row]
                np.testing.assert_array_equal(stored, array)


@pytest.mark.parametrize(("points", "dtype"), [(65_535, np.uint16), (65_536, np.uint32)])
def test_indices_are_as_wide_as_the_largest_frame_needs(tmp_path: Path, points: int, dtype: type) -> None:
    write(tmp_path / "a.h5", KNN.model_copy(update={"points": points}))
    with DriveReader(tmp_path / "a.h5", stage="graphs") as file:
        assert file["indices"].dtype == dtype


def test_motion_is_matched_by_frame_number(tmp_path: Path) -> None:
    with DriveWriter(tmp_path / "motion.h5", stage="motion", drive="drive", params={}) as writer:
        writer.put("frame", np.array([3, 5, 9, 11], np.int32))
        writer.put("yaw_rate_radps", np.array([0.3, 0.5, 0.9, 1.1], np.float32))
        writer.put("speed_mps", np.array([3, 5, 9, 11], np.float32))
        writer.put("valid", np.array([1, 1, 0, 1], np.uint8))
    with (
        DriveReader(tmp_path / "motion.h5", stage="motion") as motion,
        DriveWriter(tmp_path / "a.h5", stage="graphs", drive="drive", params={}) as writer,
    ):
        graph_file.write(writer, FRAME, TIME_S, frames(KNN), frame_graph.empty(KNN))
        graph_file.put_motion(writer, "lidar", FRAME, motion)
    with open_graphs(tmp_path / "a.h5") as graphs:
        assert graphs.motions == ("lidar",)
        yaw_rate, speed, valid = graphs.motion("lidar")
        assert (speed.tolist(), valid.tolist(), valid.dtype) == ([0, 5, 9], [0, 1, 0], np.uint8)
        assert yaw_rate == pytest.approx([0, 0.5, 0.9])
        with pytest.raises(InputError, match="no motion of kind visual"):
            graphs.motion("visual")


def write_file(folder: Path, write: Callable[..., None]) -> Path:
    write(folder / "drive.h5", "drive", np.linspace(-0.1, 0.1, FRAMES), np.arange(FRAMES), 50, np.random.default_rng(0))
    return folder / "drive.h5"


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {kind: write_file(tmp_path_factory.mktemp(kind), write) for kind, write in KINDS.items()}


def read(path: Path, runs: list[tuple[int, int]]) -> Arrays:
    with open_graphs(str(path)) as graphs:
        return graph_file.concatenate([graphs.read(*run) for run in runs])


def frame_of(path: Path, row: int) -> Arrays:
    """Return the arrays of a frame as they are in the file."""
    with DriveReader(path, stage="graphs") as file:
        return {name: file.rows_of(name, row) for name in file.pointers}


@pytest.mark.parametrize("kind", ["graph", "pointnet2"])
def test_a_batch_is_its_frames_with_shifted_numbers(paths: dict[str, Path], kind: str) -> None:
    """Arithmetic on the numbers, independent of the module's: indices and level 1 count points, level 2 centres_1."""
    batch = read(paths[kind], RUNS)
    done: dict[str, int] = {}
    for row in ROWS:
        stored = frame_of(paths[kind], row)
        before = dict(done)
        for name, array in stored.items():
            counted = {"indices": "xyz", "centres_1": "xyz", "neighbours_1": "xyz"}.get(name)
            counted = "centres_1" if name.endswith("_2") else counted
            start = before.get(name, 0)
            part = batch[name][start : start + len(array)]
            np.testing.assert_array_equal(part, array + np.int64(before.get(counted, 0)) if counted else array)
            done[name] = start + len(array)
    assert {name: len(batch[name]) for name in done} == done
    assert set(batch) - set(done) == ({"ptr"} if kind == "graph" else {"ptr", "centres_1_ptr", "centres_2_ptr"})
    assert batch["ptr"].tolist()[-1] == len(batch["xyz"])
    assert all(len(batch[name]) == len(ROWS) + 1 for name in set(batch) - set(done))
    if kind == "graph":
        dtypes = batch["indices"].dtype, batch["degree"].dtype, batch["xyz"].dtype
        assert dtypes == (np.int32, np.uint8, np.float32)


@pytest.mark.parametrize("kind", KINDS)
def test_one_run_equals_its_pieces_and_a_frame_equals_its_arrays(paths: dict[str, Path], kind: str) -> None:
    pieces, complete = read(paths[kind], [(0, 4), (4, 5), (5, 9)]), read(paths[kind], [(0, 9)])
    assert all((pieces[name] == complete[name]).all() for name in complete)
    with open_graphs(paths[kind]) as graphs, DriveReader(paths[kind], stage="graphs") as file:
        stored = {"image": file.rows("image", 3, 4)} if kind == "image" else frame_of(paths[kind], 3)
        expected, batch = graphs.read(3, 4), graph_file.single(stored)
    assert expected.keys() == batch.keys()
    assert all(np.array_equal(batch[name], expected[name]) for name in expected)
    assert all(batch[name].dtype == expected[name].dtype for name in expected)


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
