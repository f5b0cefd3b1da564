import numpy as np
import pytest

from pipeline.report.judge.baselines import baselines


def test_baselines_by_hand() -> None:
    steering = np.array([0.1, 0.2])
    result = baselines(steering, np.array([0.1, 0.3]), np.array([0.0, 0.1]), {})
    assert list(result) == ["zero", "train_mean", "persistence"]
    assert result["zero"]["nmse"] == 1.0
    assert result["train_mean"]["mse_rad2"] == pytest.approx(0.005)
    assert result["persistence"]["mse_rad2"] == pytest.approx((0.01 + 0.01) / 2)


def test_odometry_is_the_first_kind_and_others_bear_their_name() -> None:
    steering = np.array([0.1, 0.2])
    measured = {"visual": np.array([0.1, 0.1]), "lidar": steering}
    result = baselines(steering, 0.0, steering, measured)
    assert result["odometry"]["mse_rad2"] == pytest.approx(0.005)
    assert result["odometry_lidar"]["mse_rad2"] == 0
    assert "odometry" in baselines(steering, 0.0, steering, {"lidar": steering})


def test_odometry_of_a_drive_without_scans_is_not_known() -> None:
    steering = np.array([0.1, 0.2])
    result = baselines(steering, 0.0, steering, {"visual": steering, "lidar": np.array([0.1, np.nan])})
    assert result["odometry"]["nmse"] == 0
    assert (result["odometry_lidar"]["frames"], result["odometry_lidar"]["nmse"]) == (0, None)
