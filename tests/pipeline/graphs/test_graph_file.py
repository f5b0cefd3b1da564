"""Graph files of the three kinds: the file contains what the frame's functions compute."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.store import DriveReader, DriveWriter
from pipeline.graphs import graph_file
from pipeline.sections.graphs import Variant

KNN = Variant(source="clouds/pseudo", points=30, k=4, keep_inter_class=0.5)
SETS = Variant(
    **{"source": "clouds/pseudo", "neighbourhood": "pointnet2", "points": 30},
    **{"centres": [8, 3], "radius_m": [5.0, 9.0], "neighbours": [4, 2]},
)
FRAME, TIME_S = np.array([4, 5, 9]), np.array([0.0, 0.1, 0.5])


def clouds() -> list[graph_file.Points]:
    rng = np.random.default_rng(0)
    points = [(rng.uniform(-9, 9, (n, 3)).astype(np.float32), rng.integers(0, 3, n, np.uint8)) for n in (30, 0, 12)]
    return [(*each, np.random.default_rng(seed)) for seed, each in enumerate(points)]


def write(path: Path, variant: Variant, points: list[graph_file.Points]) -> graph_file.Counts:
    with DriveWriter(path, stage="graphs", drive="drive", params={}) as file:
        return graph_file.write_points(file, FRAME[: len(points)], TIME_S[: len(points)], points, variant)


@pytest.mark.parametrize("variant", [KNN, SETS])
def test_the_datasets_of_each_frame(tmp_path: Path, variant: Variant) -> None:
    counts = write(tmp_path / "a.h5", variant, clouds())
    assert (counts["frames"], counts["points"]) == (3, 42)
    with DriveReader(tmp_path / "a.h5", stage="graphs") as file:
        assert (file.frame.tolist(), file.frame.dtype, file["ptr"].tolist()) == ([4, 5, 9], np.int32, [0, 30, 30, 42])
        np.testing.assert_array_equal(file.time_s, TIME_S)
        for row, (xyz, cls, rng) in enumerate(clouds()):
            for name, array in {"xyz": xyz, "cls": cls, **graph_file.neighbours(variant, xyz, cls, rng)}.items():
                if array.ndim:
                    pointer = name.replace("neighbours", "centres") + "_ptr"
                    a, b = file[pointer if pointer in file else "ptr"][row : row + 2]
                    np.testing.assert_array_equal(file[name][a:b], array)
                else:
                    assert file[name][row] == array


@pytest.mark.parametrize(("points", "dtype"), [(65_535, np.uint16), (65_536, np.uint32)])
def test_indices_are_as_wide_as_the_largest_frame_needs(tmp_path: Path, points: int, dtype: type) -> None:
    write(tmp_path / "a.h5", KNN.model_copy(update={"points": points}), clouds())
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
        graph_file.put_motion(writer, "lidar", FRAME, motion)
    with DriveReader(tmp_path / "a.h5", stage="graphs") as file:
        assert file["lidar_speed_mps"].tolist() == [0, 5, 9]
        assert file["lidar_yaw_rate_radps"] == pytest.approx([0, 0.5, 0.9])
        assert (file["lidar_valid"].tolist(), file["lidar_valid"].dtype) == ([0, 1, 0], np.uint8)
