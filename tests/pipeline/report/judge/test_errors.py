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


def test_errors_by_curvature_stand_beside_those_of_zero() -> None:
    steering, curvature = np.array([0.0, 0.01, 0.2, -0.3]), np.array([0.0, -0.001, 0.07, -0.1])
    straight, slight, sharp = errors.by_curvature(steering, np.full(4, 0.01), curvature, [0.005, 0.03])
    assert slight == {"from_1pm": 0.005, "to_1pm": 0.03, "frames": 0}
    assert (straight["frames"], sharp["frames"], sharp["to_1pm"]) == (2, 2, None)
    assert sharp["zero"]["mse_rad2"] == pytest.approx((0.04 + 0.09) / 2)
    assert straight["mse_rad2"] == pytest.approx(0.0001 / 2)


def test_baselines_by_hand() -> None:
    steering = np.array([0.1, 0.2])
    measured = {"visual": np.array([0.1, 0.1]), "lidar": np.array([0.1, np.nan])}
    found = errors.baselines(steering, np.array([0.1, 0.3]), np.array([0.0, 0.1]), measured)
    assert list(found) == ["zero", "train_mean", "persistence", "odometry", "odometry_lidar"]
    assert found["zero"]["nmse"] == 1.0
    mse = [found[name]["mse_rad2"] for name in ("train_mean", "persistence", "odometry")]
    assert mse == pytest.approx([0.005, 0.01, 0.005])
    assert (found["odometry_lidar"]["frames"], found["odometry_lidar"]["nmse"]) == (0, None)
    assert errors.baselines(steering, 0.0, steering, {"lidar": steering})["odometry"]["nmse"] == 0
