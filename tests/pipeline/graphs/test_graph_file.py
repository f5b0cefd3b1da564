"""Graph files of the three kinds: written, and read as batches by their own declarations."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.store import DriveReader, DriveWriter
from pipeline.graphs import frame_graph, graph_file
from pipeline.graphs.graph_file import Columns, collate, open_graphs
from pipeline.settings.graphs import Variant
from tests import artefacts

KNN = Variant(source="clouds/pseudo", points=30, k=4, keep_inter_class=0.5)
SETS = Variant(
    **{"source": "clouds/pseudo", "neighbourhood": "pointnet2", "points": 30},
    **{"centres": [8, 3], "radius_m": [5.0, 9.0], "neighbours": [4, 2]},
)
FRAME, TIME_S = np.array([4, 5, 9]), np.array([0.0, 0.1, 0.5])
SPANS = [(2, 6), (8, 9), (0, 3)]
ROWS = [row for span in SPANS for row in range(*span)]
KINDS = {"graph": artefacts.write_graphs, "pointnet2": artefacts.write_sets, "image": artefacts.write_images}


def frames(variant: Variant) -> list[Columns]:
    """Return three frames, of 30, 0 and 12 points."""
    rng = np.random.default_rng(0)
    clouds = [(rng.uniform(-9, 9, (n, 3)).astype(np.float32), rng.integers(0, 3, n, np.uint8)) for n in (30, 0, 12)]
    return [frame_graph.connect(cloud, variant, np.random.default_rng(seed)) for seed, cloud in enumerate(clouds)]


def write(path: Path, variant: Variant) -> graph_file.Counts:
    with DriveWriter(path, stage="graphs", drive="drive", params={}) as file:
        return graph_file.write(file, FRAME, TIME_S, frames(variant), frame_graph.empty_frame(variant))


@pytest.mark.parametrize("variant", [KNN, SETS])
def test_the_file_has_each_frame(tmp_path: Path, variant: Variant) -> None:
    counts = write(tmp_path / "a.h5", variant)
    assert (counts["frames"], counts["points"]) == (3, 42)
    with DriveReader(tmp_path / "a.h5", stage="graphs") as file:
        assert (file.frame.tolist(), file.frame.dtype, file["ptr"].tolist()) == ([4, 5, 9], np.int32, [0, 30, 30, 42])
        np.testing.assert_array_equal(file.time_s, TIME_S)
        for row, columns in enumerate(frames(variant)):
            for name, column in columns.items():
                stored = file.rows_of(name, row) if column.pointer else file[name][row]
                np.testing.assert_array_equal(stored, column.rows if column.pointer else column.rows[0])
                assert file.refers_to.get(name, "") == column.refers_to


@pytest.mark.parametrize(("points", "dtype"), [(65_535, np.uint16), (65_536, np.uint32)])
def test_indices_are_as_wide_as_the_largest_frame_needs(tmp_path: Path, points: int, dtype: type) -> None:
    write(tmp_path / "a.h5", KNN.model_copy(update={"points": points}))
    with DriveReader(tmp_path / "a.h5", stage="graphs") as file:
        assert file["indices"].dtype == dtype


def test_motion_is_matched_by_frame_number(tmp_path: Path) -> None:
    with DriveWriter(tmp_path / "motion.h5", stage="motion", drive="drive", params={}) as writer:
        writer.put("frame", np.array([3, 5, 9, 11], np.int32))
        writer.put("yaw_rate_radps", np.array([0.3, 0.5, 0.9, 1.1], np.float32))
        writer.put("filtered_mps", np.array([3, 5, 9, 11], np.float32))
        writer.put("valid", np.array([1, 1, 0, 1], np.uint8))
    with (
        DriveReader(tmp_path / "motion.h5", stage="motion") as motion,
        DriveWriter(tmp_path / "a.h5", stage="graphs", drive="drive", params={}) as writer,
    ):
        graph_file.write(writer, FRAME, TIME_S, frames(KNN), frame_graph.empty_frame(KNN))
        graph_file.put_motion(writer, FRAME, motion)
    with open_graphs(tmp_path / "a.h5") as graphs:
        assert graphs.motion
        yaw_rate, speed, valid = graphs.motion
        assert (speed.tolist(), valid.tolist(), valid.dtype) == ([0, 5, 9], [0, 1, 0], np.uint8)
        assert yaw_rate == pytest.approx([0, 0.5, 0.9])


def write_file(path: Path, write: Callable[..., None]) -> Path:
    write(path, "drive", np.linspace(-0.1, 0.1, 9), np.arange(9), 50, np.random.default_rng(0))
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_a_batch_is_its_frames_with_shifted_numbers(tmp_path: Path, kind: str) -> None:
    """Arithmetic on the numbers, independent of the module's: indices and level 1 count points, level 2 centres_1."""
    path = write_file(tmp_path / "drive.h5", KINDS[kind])
    with open_graphs(path) as graphs:
        batch = collate([(graphs, *span) for span in SPANS])
        pieces = collate([(graphs, row, row + 1) for row in ROWS])
        contents = graphs.contents
    assert contents.kind == kind
    assert all(np.array_equal(batch[name], pieces[name]) for name in batch)
    counted = dict.fromkeys(("indices", "centres_1", "neighbours_1"), "xyz")
    counted |= dict.fromkeys(("centres_2", "neighbours_2"), "centres_1")
    done = dict.fromkeys(batch, 0)
    with DriveReader(path, stage="graphs") as file:
        for row in ROWS:
            stored = {name: file.rows_of(name, row) for name in file.pointers}
            before = dict(done)
            for name, array in stored.items():
                part = batch[name][before[name] : before[name] + len(array)]
                assert (part.dtype == np.int32) if name in counted else (part.dtype == array.dtype)
                np.testing.assert_array_equal(part, array + np.int64(before[counted[name]] if name in counted else 0))
                done[name] += len(array)
        pointers = set(file.pointers.values())
        for name, pointer in file.pointers.items():
            assert batch[pointer][-1] == done[name] == len(batch[name])
    assert all(len(batch[pointer]) == len(ROWS) + 1 for pointer in pointers)
