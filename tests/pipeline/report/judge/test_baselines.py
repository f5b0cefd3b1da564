import numpy as np
import pytest

from pipeline.report.judge import baselines


def test_persistence_uses_the_last_valid_frame_before() -> None:
    steering = np.array([0.1, 0.2, 0.3, 0.4])
    valid = np.array([True, False, True, True])
    assert baselines.last_valid(steering, valid) == pytest.approx([np.nan, 0.1, 0.1, 0.3], nan_ok=True)
    assert len(baselines.last_valid(np.empty(0), np.empty(0, bool))) == 0


def test_baselines_by_hand() -> None:
    steering = np.array([0.1, 0.2])
    result = baselines.baselines(steering, np.array([np.nan, 0.1]), train_mean_rad=0.1)
    assert result["zero"]["nmse"] == 1.0
    assert result["train_mean"]["mse_rad2"] == pytest.approx(0.005)
    assert result["persistence"]["mse_rad2"] == pytest.approx((0.01 + 0.01) / 2)
