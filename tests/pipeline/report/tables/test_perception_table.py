import numpy as np

from pipeline.perception.scores import Scores
from pipeline.report.tables import perception_table


def metrics() -> dict[str, dict]:
    """Training frames without any truth, validation with LiDAR, test with dense depth and classes."""
    scores = {split: Scores() for split in ("train", "val", "test")}
    truth = np.full((40, 50), 10.0)
    scores["val"].add_depth("depth_lidar", 1.2 * truth, truth)
    scores["val"].add_depth("ground_plane_lidar", 1.5 * truth, truth)
    scores["test"].add_depth(
        "depth_dense", truth, np.where(np.arange(40)[:, None] < 2, truth, 0)
    )  # outside of the crop
    scores["test"].add_depth("ground_plane_dense", 2 * truth, truth)
    scores["test"].add_classes(np.array([[0, 0, 1, 1]]), np.array([[0, 0, 0, 1]]))
    return {split: score.report() for split, score in scores.items()}


def test_each_truth_of_each_split_has_a_row() -> None:
    lines = perception_table.markdown(metrics()).splitlines()
    flat, eigen = "0.500, 5.00, 0.000", "0.200, 2.00, 1.000"
    assert f"| val | LiDAR | 1 | {eigen} | {flat} | {eigen} | {flat} |" in lines
    assert "| test | dense | 1 | 0.000, 0.00, 1.000 | 1.000, 10.00, 0.000 | none | 1.000, 10.00, 0.000 |" in lines
    assert "| test | 1 | 0.750 | 0.583 | 2 |" in lines
    assert not any(line.startswith("| train") for line in lines)


def test_without_any_truth_there_is_no_table() -> None:
    assert perception_table.markdown(dict.fromkeys(("train", "val", "test"), Scores().report())) == ""
