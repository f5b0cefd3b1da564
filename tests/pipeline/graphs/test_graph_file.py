"""The three kinds of graph files: what is written frame by frame is what each frame is."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.store import DriveReader, DriveWriter
from pipeline.graphs import graph, graph_file, neighbourhoods

FRAME, TIME_S = np.array([4, 5, 9]), np.array([0.0, 0.1, 0.5])


def clouds(counts: tuple[int, ...] = (30, 0, 12)) -> list[graph_file.Points]:
    """Frames of so many points each, with a generator of their own."""
    rng = np.random.default_rng(0)
    return [
        (
            rng.uniform(-9, 9, (count, 3)).astype(np.float32),
            rng.integers(0, 3, count, np.uint8),
            np.random.default_rng(i),
        )
        for i, count in enumerate(counts)
    ]


def written(path: Path, neighbours: graph_file.Neighbours) -> tuple[graph_file.Counts, DriveReader]:
    with DriveWriter(path, stage="graphs", drive="drive", params={}) as file:
        counts = graph_file.write_points(file, FRAME, TIME_S, clouds(), neighbours)
    return counts, DriveReader(path, stage="graphs")


def test_graphs_are_those_of_their_frames(tmp_path: Path) -> None:
    counts, file = written(tmp_path / "a.h5", graph_file.KnnGraph(30, 4, 0.5))
    made = [graph.build(xyz, cls, 4, 0.5, rng) for xyz, cls, rng in clouds()]
    with file:
        assert (file.frame.tolist(), file.frame.dtype, file["ptr"].tolist()) == ([4, 5, 9], np.int32, [0, 30, 30, 42])
        np.testing.assert_array_equal(file.time_s, TIME_S)
        np.testing.assert_array_equal(file["xyz"], np.concatenate([xyz for xyz, *_ in clouds()]))
        np.testing.assert_array_equal(file["cls"], np.concatenate([cls for _, cls, _ in clouds()]))
        for row, one in enumerate(made):
            a, b = file["indices_ptr"][row : row + 2]
            np.testing.assert_array_equal(file["indices"][a:b], one.indices)
            a, b = file["ptr"][row : row + 2]
            np.testing.assert_array_equal(file["degree"][a:b], one.degree)
            assert (file["edges_knn"][row], file["edges_kept"][row]) == (one.edges_knn, one.edges_kept)
    assert counts == {
        "frames": 3,
        "points": 42,
        "kNN edges": sum(one.edges_knn for one in made),
        "kept": sum(one.edges_kept for one in made),
    }


def test_sets_are_those_of_their_frames(tmp_path: Path) -> None:
    sizes = [(8, 5.0, 4), (3, 9.0, 2)]
    points = [(*cloud[:2], cloud[2]) for cloud in clouds((30, 5, 12))]
    with DriveWriter(tmp_path / "a.h5", stage="graphs", drive="drive", params={}) as writer:
        counts = graph_file.write_points(writer, FRAME, TIME_S, points, graph_file.PointSets(30, sizes))
    with DriveReader(tmp_path / "a.h5", stage="graphs") as file:
        for row, (xyz, _, rng) in enumerate(clouds((30, 5, 12))):
            for number, level in enumerate(neighbourhoods.levels(xyz, sizes, rng), start=1):
                a, b = file[f"centres_{number}_ptr"][row : row + 2]
                np.testing.assert_array_equal(file[f"centres_{number}"][a:b], level.centres)
                np.testing.assert_array_equal(file[f"neighbours_{number}"][a:b], level.neighbours)
    assert counts == {"frames": 3, "points": 47, "centres": 8 + 5 + 8 + 3 * 3}


@pytest.mark.parametrize(("points", "dtype"), [(65_535, np.uint16), (65_536, np.uint32)])
def test_numbers_are_as_wide_as_the_largest_frame_needs(tmp_path: Path, points: int, dtype: type) -> None:
    with written(tmp_path / "a.h5", graph_file.KnnGraph(points, 4, 1.0))[1] as file:
        assert file["indices"].dtype == dtype


def test_images_are_written_as_they_are(tmp_path: Path) -> None:
    images = np.random.default_rng(0).integers(0, 256, (3, 6, 8, 3), np.uint8)
    with DriveWriter(tmp_path / "a.h5", stage="graphs", drive="drive", params={}) as writer:
        assert graph_file.write_images(writer, FRAME, TIME_S, images, (6, 8)) == {"frames": 3}
    with DriveReader(tmp_path / "a.h5", stage="graphs") as file:
        np.testing.assert_array_equal(file["image"], images)
        np.testing.assert_array_equal(file.frame, FRAME)


def test_a_drive_without_frames_has_empty_datasets(tmp_path: Path) -> None:
    none = np.zeros(0)
    for name, neighbours in (("a", graph_file.KnnGraph(9, 2, 1.0)), ("b", graph_file.PointSets(9, [(4, 1.0, 2)]))):
        with DriveWriter(tmp_path / f"{name}.h5", stage="graphs", drive="drive", params={}) as writer:
            assert not any(graph_file.write_points(writer, none, none, [], neighbours).values())
        with DriveReader(tmp_path / f"{name}.h5", stage="graphs") as file:
            assert (file.shape("xyz"), file["ptr"].tolist()) == ((0, 3), [0])


def test_motion_goes_by_frame_number_and_is_0_where_there_is_none(tmp_path: Path) -> None:
    with DriveWriter(tmp_path / "motion.h5", stage="motion", drive="drive", params={}) as writer:
        writer.put("frame", np.array([3, 5, 9, 11], np.int32))
        writer.put("yaw_rate_radps", np.array([0.3, 0.5, 0.9, 1.1], np.float32))
        writer.put("speed_mps", np.array([3, 5, 9, 11], np.float32))
        writer.put("valid", np.array([1, 1, 0, 1], np.uint8))
    with (
        DriveReader(tmp_path / "motion.h5", stage="motion") as motion,
        DriveWriter(tmp_path / "a.h5", stage="graphs", drive="drive", params={}) as writer,
    ):
        graph_file.put_motion(writer, "lidar", FRAME, motion)
    with DriveReader(tmp_path / "a.h5", stage="graphs") as file:
        assert file["lidar_speed_mps"].tolist() == [0, 5, 9]
        assert file["lidar_yaw_rate_radps"] == pytest.approx([0, 0.5, 0.9])
        assert (file["lidar_valid"].tolist(), file["lidar_valid"].dtype) == ([0, 1, 0], np.uint8)
        assert "visual_valid" not in file
