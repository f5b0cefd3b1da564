import numpy as np
import pytest

from pipeline.report.judge import errors


def test_scores_by_hand() -> None:
    result = errors.scores(np.array([0.1, -0.1, 0.2]), np.array([0.1, 0.1, 0.1]))
    assert result["frames"] == 3
    assert result["mse_rad2"] == pytest.approx((0 + 0.04 + 0.01) / 3)
    assert result["nmse"] == pytest.approx(0.05 / 0.06)
    assert result["mae_deg"] == pytest.approx(np.rad2deg(0.1))
    assert result["rmse_deg"] == pytest.approx(np.rad2deg(np.sqrt(0.05 / 3)))


def test_bins_show_what_driving_straight_on_would_score() -> None:
    steering, curvature = np.array([0.0, 0.01, 0.2, -0.3]), np.array([0.0, 0.001, 0.07, -0.1])
    straight, slight, sharp = errors.by_curvature(steering, np.full(4, 0.01), curvature, [0.005, 0.03])
    assert [row["frames"] for row in (straight, slight, sharp)] == [2, 0, 2]
    assert "zero" not in slight
    assert sharp["zero"]["mse_rad2"] == pytest.approx((0.04 + 0.09) / 2)
    assert straight["mse_rad2"] == pytest.approx(0.0001 / 2)


def test_labels_that_are_all_zero_have_no_nmse() -> None:
    assert errors.scores(np.zeros(3), np.ones(3))["nmse"] is None


def test_no_frames_have_no_errors() -> None:
    result = errors.scores(np.empty(0), np.empty((2, 0)))
    assert result == {"frames": 0, "mse_rad2": None, "rmse_deg": None, "mae_deg": None, "nmse": None}


def test_curvature_bins_split_the_frames() -> None:
    curvature = np.array([0.0, -0.004, 0.01, -0.02, 0.1])
    rows = errors.by_curvature(np.full(5, 0.1), np.zeros(5), curvature, [0.005, 0.03])
    assert [row["frames"] for row in rows] == [2, 2, 1]
    assert rows[-1]["to_1pm"] is None
    empty = errors.by_curvature(np.full(2, 0.1), np.zeros(2), np.zeros(2), [0.005])
    assert empty[1] == {"from_1pm": 0.005, "to_1pm": None, "frames": 0}
