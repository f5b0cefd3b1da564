"""Runs of frames of each kind are what the file says, frame by frame."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.train import frames
from tests import artefacts

FRAMES = 9
RUNS = [(2, 6), (8, 9), (0, 3)]


def made(tmp_path: Path, write: Callable[..., None]) -> Path:
    steering_rad = np.linspace(-0.1, 0.1, FRAMES)
    write(tmp_path / "drive.h5", "drive", steering_rad, np.arange(FRAMES), 50, np.random.default_rng(0))
    return tmp_path / "drive.h5"


def read(path: Path, runs: list[tuple[int, int]]) -> frames.Arrays:
    with frames.open_graphs(path) as graphs:
        return frames.concatenate([graphs.read(*run) for run in runs])


@pytest.mark.parametrize(
    ("write", "contents", "words"),
    [
        (artefacts.write_graphs, {"kind": "graph"}, ["kNN graphs"]),
        (artefacts.write_sets, {"kind": "pointnet2", "levels": 2}, ["points", "PointNet++", "2 levels"]),
        (artefacts.write_images, {"kind": "image", "image_size": (32, 48)}, ["images", "32 x 48"]),
    ],
)
def test_contents(tmp_path: Path, write: Callable[..., None], contents: dict[str, object], words: list[str]) -> None:
    assert frames.contents(made(tmp_path, write)) == contents
    assert all(word in frames.described(contents) for word in words)


def test_a_graph_file_is_opened_by_path_or_text_and_numbers_its_frames(tmp_path: Path) -> None:
    path = made(tmp_path, artefacts.write_graphs)
    for name in (path, str(path)):
        with frames.open_graphs(name) as graphs:
            assert graphs.frame.tolist() == list(range(FRAMES))
            assert graphs.time_s == pytest.approx(np.arange(FRAMES) * 0.1)
    with pytest.raises(InputError, match="missing"), frames.open_graphs(tmp_path / "other.h5"):
        pass


def test_neighbours_are_the_same_points_wherever_they_lie_in_the_batch(tmp_path: Path) -> None:
    path = made(tmp_path, artefacts.write_sets)
    batch = read(path, RUNS)
    assert set(batch) == {
        "xyz", "cls", "ptr", "centres_1", "neighbours_1", "centres_1_ptr", "centres_2", "neighbours_2", "centres_2_ptr"
    }  # fmt: skip
    with store.DriveReader(path, stage="graphs") as file:
        stored = {name: file[name] for name in batch}
    for number, row in enumerate([row for run in RUNS for row in range(*run)]):

        def mine(name: str, number: int = number) -> np.ndarray:
            ptr = batch["ptr" if name in ("xyz", "cls") else f"centres_{name[-1]}_ptr"]
            return batch[name][ptr[number] : ptr[number + 1]]

        def theirs(name: str, row: int = row) -> np.ndarray:
            ptr = stored["ptr" if name in ("xyz", "cls") else f"centres_{name[-1]}_ptr"]
            return stored[name][ptr[row] : ptr[row + 1]]

        assert (mine("xyz") == theirs("xyz")).all()
        assert (mine("cls") == theirs("cls")).all()
        for name in ("centres_1", "neighbours_1"):
            assert (batch["xyz"][mine(name)] == theirs("xyz")[theirs(name)]).all()
        first = theirs("xyz")[theirs("centres_1")]
        for name in ("centres_2", "neighbours_2"):
            assert (batch["xyz"][batch["centres_1"][mine(name)]] == first[theirs(name)]).all()
    assert batch["ptr"][-1] == len(batch["xyz"])
    assert len(batch["ptr"]) == len(batch["centres_2_ptr"]) == 1 + 8


def test_graphs_keep_their_edges_wherever_they_lie_in_the_batch(tmp_path: Path) -> None:
    path = made(tmp_path, artefacts.write_graphs)
    batch = read(path, RUNS)
    assert (batch["indices"].dtype, batch["degree"].dtype, batch["xyz"].dtype) == (np.int32, np.uint8, np.float32)
    with store.DriveReader(path, stage="graphs") as file:
        ptr, indices_ptr, indices, xyz = (file[name] for name in ("ptr", "indices_ptr", "indices", "xyz"))
    rows = [row for run in RUNS for row in range(*run)]
    ends = np.concatenate([xyz[ptr[row] + indices[indices_ptr[row] : indices_ptr[row + 1]]] for row in rows])
    np.testing.assert_array_equal(batch["xyz"][batch["indices"]], ends)


def test_images_are_read_as_they_are(tmp_path: Path) -> None:
    path = made(tmp_path, artefacts.write_images)
    with store.DriveReader(path, stage="graphs") as file:
        assert (read(path, RUNS)["image"] == file["image"][[2, 3, 4, 5, 8, 0, 1, 2]]).all()


def test_one_run_is_one_read(tmp_path: Path) -> None:
    for write in (artefacts.write_graphs, artefacts.write_sets):
        path = made(tmp_path, write)
        pieces, whole = read(path, [(0, 4), (4, 5), (5, 9)]), read(path, [(0, 9)])
        assert all((pieces[name] == whole[name]).all() for name in whole)


def test_motion_is_that_of_the_file_and_a_kind_that_it_lacks_is_one_line(tmp_path: Path) -> None:
    motion = frames.Motion(np.array([0.1, 0.2], np.float32), np.array([4, 5], np.float32), np.array([0, 1], np.uint8))
    with store.DriveWriter(tmp_path / "a.h5", stage="graphs", drive="drive", params={}) as file:
        file.put("frame", np.arange(2, dtype=np.int32))
        file.put("time_s", np.arange(2) / 10)
        for name, values in motion._asdict().items():
            file.put(f"visual_{name}", values)
    with frames.open_graphs(tmp_path / "a.h5") as graphs:
        assert graphs.motions == ("visual",)
        for stored, written in zip(graphs.motion("visual"), motion, strict=True):
            np.testing.assert_array_equal(stored, written)
        with pytest.raises(InputError, match=r"no motion: lidar \(it has visual\): put lidar into motion\.kinds"):
            graphs.motion("lidar")
    with frames.open_graphs(made(tmp_path, artefacts.write_graphs)) as graphs:
        assert graphs.motions == ()
