"""Tables of the report: cells and widths."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.perception.scores import Scores
from pipeline.report import perception, tables
from tests.pipeline.report import examples

CARD = {
    "drives": 2, "frames": 153, "valid": 0.99, "judged": 140, "yaw_rmse_degps": 0.16, "yaw_median_degps": 0.11,
    "speed_ratio": 0.977, "nmse": 0.0005,
}  # fmt: skip


def cells(table: tables.Table, model: str) -> dict[str, str]:
    rows = table.cells
    return rows[rows.iloc[:, 0] == model].iloc[0].to_dict()


def test_the_first_table_fits_a_terminal(tmp_path: Path) -> None:
    content = examples.metrics("pointnet2-lstm", odometry={"odometry": 0.04, "odometry_lidar": 0.03}, horizon=10)
    content["seeds"] = [0, 1, 2]
    content["test"]["nmse_std"] = 0.03
    content["parameters"] = 1_408_259
    first, *_ = tables.steering_tables(examples.results(tmp_path, content))
    lines = first.markdown().splitlines()
    assert len(first.cells.columns) <= 9
    assert max(map(len, lines)) <= 110
    row = cells(first, "pointnet2-lstm")
    assert (row["test nmse"], row["95 % interval"], row["ahead"]) == ("0.200 ± 0.030", "0.100 to 0.300", "10")
    assert (row["no onsets"], row["parameters"], row["edges"]) == ("0.100", "1,408,259", "5,160")
    assert cells(first, "*odometry*")["parameters"] == tables.NONE
    assert "Means over 3 seeds" in first.note


def test_points_without_edges_are_neither_pruned_nor_drawn(tmp_path: Path) -> None:
    content = examples.metrics("polar") | {"variant": {"k": 0}, "edges_per_frame": 0.0, "edges_per_frame_unpruned": 0.0}
    results = examples.results(tmp_path, content)
    models = next(table for table in tables.steering_tables(results) if table.title == "Models")
    assert cells(models, "polar")["pruned"] == tables.NONE
    assert results.models.iloc[0]["variant.k"] is None


def test_the_table_by_drive_has_a_row_per_drive(tmp_path: Path) -> None:
    results = examples.results(tmp_path, examples.metrics("sa-gnn-ncp"), examples.metrics("motion-10", horizon=10))
    table = next(table for table in tables.steering_tables(results) if table.title == "nmse by test drive")
    assert table.cells["drive"].tolist() == [*examples.DRIVES]
    assert table.cells["sa-gnn-ncp +0"].tolist() == ["0.190", "0.180"]
    assert table.cells["*zero* +10"].tolist() == ["1.000", "1.000"]


def test_perception_has_a_row_per_split_with_ground_truth(tmp_path: Path) -> None:
    scores = {split: Scores() for split in ("train", "val", "test")}
    truth = np.full((40, 50), 10.0)
    scores["val"].add_depth("depth_lidar", 1.2 * truth, truth)
    scores["val"].add_depth("ground_plane_lidar", 1.5 * truth, truth)
    outside_crop = np.where(np.arange(40)[:, None] < 2, truth, 0)
    scores["test"].add_depth("depth_dense", truth, outside_crop)
    scores["test"].add_classes(np.array([[0, 0, 1, 1]]), np.array([[0, 0, 0, 1]]))
    motion = {"visual": {"train": None, "val": None, "test": CARD}}
    report = {split: score.report() for split, score in scores.items()} | {"motion": motion}
    store.write_json(tmp_path / "metrics.json", report)
    loaded = perception.load_scores(tmp_path)
    assert loaded
    depth, classes, measured = perception.tables(loaded)
    encoder, flat = "0.200, 2.00, 1.000", "0.500, 5.00, 0.000"
    assert depth.cells.to_numpy().tolist() == [
        ["val", "lidar", "1", "100.0%", encoder, flat, encoder, flat],
        ["test", "dense", "1", "100.0%", "0.000, 0.00, 1.000", tables.NONE, tables.NONE, tables.NONE],
    ]
    assert classes.cells.to_numpy().tolist() == [["test", "1", "0.750", "0.583", "2"]]
    row = ["visual", "test", "2", "153", "99.0%", "140", "0.160", "0.110", "0.977", "0.0005"]
    assert measured.cells.to_numpy().tolist() == [row]


def test_forged_scores_are_one_error(tmp_path: Path) -> None:
    report = {split: Scores().report() for split in ("train", "val", "test")}
    store.write_json(tmp_path / "metrics.json", report)
    assert perception.load_scores(tmp_path) == report | {"motion": {}}
    assert perception.tables(report | {"motion": {}}) == []
    store.write_json(tmp_path / "metrics.json", report | {"val": {**report["val"], "classes": {"frames": 3}}})
    with pytest.raises(InputError, match=r"val\.classes\.pixel_accuracy"):
        perception.load_scores(tmp_path)
