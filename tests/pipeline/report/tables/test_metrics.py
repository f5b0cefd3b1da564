import numpy as np
import pytest

from pipeline.perception.scores import Scores
from pipeline.report.tables import metrics
from tests.pipeline.report.tables.results import result, scores


def test_names_are_flat_and_what_was_not_measured_is_left_out() -> None:
    model = result("net", nmse=0.2)
    assert metrics.figures([model], None) == pytest.approx(
        {
            "net.nmse": 0.2,
            "net.nmse_low": 0.1,
            "net.nmse_high": 0.3,
            "net.mae_deg": 4 * 0.2**0.5,
            "net.train_nmse": 0.1,
        }
    )
    ahead = result("net-10", odometry={"odometry": 0.4}, horizon=10)
    assert metrics.figures([model, ahead], None)["odometry-10.nmse"] == 0.4
    model["val"] = scores(0.15)
    model["test"]["nmse"] = None  # a drive that is straight throughout
    figures = metrics.figures([model], None)
    assert figures["net.val_nmse"] == 0.15
    assert "net.nmse" not in figures


def test_the_encoder_has_figures_for_each_split_with_a_truth() -> None:
    of_split = {split: Scores() for split in ("train", "val", "test")}
    truth = np.full((40, 50), 10.0)
    of_split["train"].add_depth("depth_lidar", 1.2 * truth, truth)
    of_split["test"].add_depth("depth_dense", 1.1 * truth, truth)
    of_split["test"].add_classes(np.array([[0, 0, 1, 1]]), np.array([[0, 0, 1, 1]]))
    figures = metrics.figures([], {split: score.report() for split, score in of_split.items()})
    expected = {"encoder.train_abs_rel_lidar": 0.2, "encoder.abs_rel_dense": 0.1, "encoder.miou": 1.0}
    assert figures == pytest.approx(expected)


def test_motion_has_figures_for_each_kind_and_split_that_was_judged() -> None:
    nothing = {split: Scores().report() for split in ("train", "val", "test")}
    card = {"frames": 9, "valid": 0.9, "yaw_rmse_degps": 0.3, "yaw_median_degps": 0.1, "speed_ratio": 1.1, "nmse": 0.02}
    motion = {"visual": {"train": {**card, "nmse": None}, "val": None, "test": card}}
    assert metrics.figures([], {**nothing, "motion": motion}) == {
        "motion.visual.nmse": 0.02,
        "motion.visual.valid": 0.9,
        "motion.visual.yaw_rmse_degps": 0.3,
        "motion.visual.speed_ratio": 1.1,
        "motion.visual.train_valid": 0.9,
        "motion.visual.train_yaw_rmse_degps": 0.3,
        "motion.visual.train_speed_ratio": 1.1,
    }
