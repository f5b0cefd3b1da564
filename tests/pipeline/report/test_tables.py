"""Tables of the report: cells, widths, paired differences."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.perception.scores import Scores
from pipeline.report import perception, tables
from pipeline.report.results import load_groups
from pipeline.settings.evaluate import Evaluate
from tests.pipeline.report import examples
from tests.pipeline.report.examples import metrics

SETTINGS = Evaluate(bootstrap_samples=50, bootstrap_block_frames=5, curvature_bins_1pm=[0.1], seed=0)
MOTION = {
    "drives": 2, "frames": 153, "valid": 0.99, "judged": 140, "yaw_rmse_degps": 0.16, "yaw_median_degps": 0.11,
    "speed_ratio": 0.977, "nmse": 0.0005,
}  # fmt: skip


def build(data: Path, *contents: dict[str, object]) -> dict[str, tables.Table]:
    return {table.title: table for table in tables.steering_tables(examples.groups(data, *contents), SETTINGS)}


def test_the_first_table_fits_a_terminal(tmp_path: Path) -> None:
    content = metrics("pointnet2-lstm", odometry={"odometry": 0.04}, horizon=10)
    content["test"]["steering_rad"]["nmse_std"] = 0.03
    content["parameters"] = 1_408_259
    table = build(tmp_path, content)["Results: steering angle, 10 frames ahead"]
    assert max(map(len, table.markdown().splitlines())) <= 110
    rows = {row["model"]: row for row in table.rows}
    assert rows["pointnet2-lstm"] == {
        "model": "pointnet2-lstm", "nmse": "0.200 ± 0.030 (0.100 to 0.300)", "MAE deg": "2.05", "no onsets": "0.100",
        "parameters": "1,408,259", "edges": "5,160",
    }  # fmt: skip
    assert build(tmp_path, metrics("net"))["Results: steering angle"].rows[0]["drift"] == "3.0"
    assert (rows["*odometry*"]["nmse"], rows["*odometry*"]["parameters"]) == ("0.040", tables.NONE)


def test_a_path_has_a_column_per_range(tmp_path: Path) -> None:
    built = build(tmp_path, metrics("path", predict="path", odometry={"odometry": 0.4}))
    rows = {row["model"]: row for row in built["Results: path ahead"].rows}
    assert (rows["path"]["nmse 0-5 m"], rows["*odometry*"]["nmse 5-10 m"]) == ("0.200 (0.100 to 0.300)", "0.400")
    rows = {row["model"]: row for row in built["Without onsets: path ahead"].rows}
    assert rows["path"]["nmse 0-5 m"] == "0.100 (0.100 to 0.300)"
    assert "MSE as in the paper's Table 2" not in built


def test_points_without_edges_are_not_pruned(tmp_path: Path) -> None:
    content = metrics("polar") | {"edges_per_frame": 0.0, "edges_per_frame_unpruned": 0.0}
    (row,) = build(tmp_path, content)["Models"].rows
    assert (row["edges"], row["pruned"]) == ("0", tables.NONE)


@pytest.mark.parametrize("predict", ["angle", "path"])
def test_the_difference_is_paired_on_common_frames(tmp_path: Path, predict: str) -> None:
    """Predictions are multiples of the truth, so each error is known: (1 - scale)² of zero's."""
    columns = examples.PATH if predict == "path" else examples.ANGLE
    for model, scale, first in (("scene", 0.8, 7), ("blind", 0.5, 0)):
        table = examples.predictions(0.0, columns)
        for column in columns:
            table[f"predicted_{column}"] = (scale * table[f"true_{column}"]).where(table["frame"] >= first)
        content = metrics(model, 0.1 / scale, predict=predict) | {"seeds": [0, 1] if model == "scene" else [0]}
        examples.write_model(tmp_path, content, table)
    groups = load_groups(tmp_path / "evaluate", ["blind", "scene"])
    for column in columns:
        nmse, bounds = tables.difference(groups[0].predictions, "scene", "blind", column, SETTINGS)
        assert [nmse, *(bounds or [])] == pytest.approx([0.04 - 0.25] * 3)
    built = {table.title: table for table in tables.steering_tables(groups, SETTINGS)}
    (row,) = built[f"Differences: {groups[0].title}"].rows
    assert row["models"] == "scene − blind"
    assert row["5-10 m" if predict == "path" else "nmse"] == "-0.210 (-0.210 to -0.210)"


def test_models_without_common_frames_have_no_difference(tmp_path: Path) -> None:
    table = examples.predictions(0.01)
    for model, drive in zip(("scene", "blind"), examples.DRIVES, strict=True):
        examples.write_model(tmp_path, metrics(model), table[table["drive"] == drive])
    built = tables.steering_tables(load_groups(tmp_path / "evaluate", ["scene", "blind"]), SETTINGS)
    assert next(table for table in built if table.title.startswith("Differences")).rows[0]["nmse"] == tables.NONE


def test_a_predicted_uncertainty_has_a_row(tmp_path: Path) -> None:
    content = metrics("net")
    known = {"nll": -2.0, "nll_constant": -1.5, "coverage_68": 0.7, "coverage_95": 0.94, "mae_certain": 0.02}
    content["test"]["steering_rad"] |= {"uncertainty": known, "mae": 0.04}
    (row,) = build(tmp_path, content)["Uncertainty: steering angle"].rows
    assert [*row.values()] == ["net", "-2.000", "-1.500", "70.0%", "94.0%", "50%"]


def test_perception_has_a_row_per_split_with_ground_truth() -> None:
    scores = {split: Scores() for split in ("train", "val", "test")}
    truth = np.full((40, 50), 10.0)
    scores["val"].add_depth("depth_lidar", 1.2 * truth, truth)
    scores["val"].add_depth("ground_plane_lidar", 1.5 * truth, truth)
    scores["test"].add_depth("depth_dense", truth, np.where(np.arange(40)[:, None] < 2, truth, 0))  # outside the crop
    scores["test"].add_classes(np.array([[0, 0, 1, 1]]), np.array([[0, 0, 0, 1]]))
    motion = {"visual": {"train": None, "val": None, "test": MOTION}}
    report = {split: score.report() for split, score in scores.items()} | {"motion": motion}
    depth, classes, measured = perception.tables(report)
    encoder, flat = "0.200, 2.00, 1.000", "0.500, 5.00, 0.000"
    assert depth.cells == [
        ["val", "lidar", "1", "100.0%", encoder, flat, encoder, flat],
        ["test", "dense", "1", "100.0%", "0.000, 0.00, 1.000", tables.NONE, tables.NONE, tables.NONE],
    ]
    assert classes.cells == [["test", "1", "0.750", "0.583", "2"]]
    assert measured.cells == [["visual", "test", "2", "153", "99.0%", "140", "0.160", "0.110", "0.977", "0.0005"]]
