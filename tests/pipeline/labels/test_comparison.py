import numpy as np
import pytest

from pipeline.labels import comparison
from pipeline.labels.label import Labels, steering_angle

TRUE_YAW, TRUE_SPEED = np.array([0.2, 0.2, 0.2, 0.2, 0.2]), np.array([6.0, 6.0, 6.0, 6.0, 0.2])
VALID = np.array([0, 1, 0, 1, 1], bool)


def labels(yaw_rate_radps: np.ndarray, speed_mps: np.ndarray, measured: np.ndarray = np.ones(5, bool)) -> Labels:
    valid = measured & (speed_mps >= 1.0)
    return Labels(steering_angle(yaw_rate_radps, speed_mps, 2.7), valid, speed_mps, yaw_rate_radps)


TRUE = labels(TRUE_YAW, TRUE_SPEED)


def errors(yaw_error: float, ratio: float) -> comparison.Errors:
    return comparison.errors(labels((TRUE_YAW + yaw_error) * VALID, TRUE_SPEED * ratio * VALID, VALID), TRUE)


def test_scores_use_measured_frames_above_the_minimum_speed() -> None:
    scores = comparison.score([errors(0.01, 1.1)])
    assert scores
    true, held = np.arctan(2.7 * 0.2 / 6), np.arctan(2.7 * 0.21 / 6.6)
    assert scores == pytest.approx(
        {
            "drives": 1,
            "frames": 5,
            "valid": 2 / 5,
            "judged": 3,
            "yaw_rmse_degps": np.degrees(0.01),
            "yaw_median_degps": np.degrees(0.01),
            "speed_ratio": 1.1,
            "nmse": (held - true) ** 2 / true**2,  # frames 1 to 3: the first is not measured yet, the last too slow
        }
    )
    assert "40% of 5 frames measured, yaw rate to 0.57 deg/s, speed x 1.100, steering nmse" in comparison.summary_line(
        scores
    )


def test_recorded_angles_have_neither_speed_nor_yaw_rate() -> None:
    unknown = np.full(5, np.nan)
    wheel = Labels(1.1 * TRUE.steering_rad, TRUE.valid, unknown, unknown)
    scores = comparison.score([comparison.errors(wheel, TRUE)])
    assert scores
    assert (scores["yaw_rmse_degps"], scores["speed_ratio"], scores["judged"]) == (None, None, 4)
    assert scores["nmse"] == pytest.approx(0.01)
    assert comparison.summary_line(scores) == "80% of 5 frames measured, steering nmse 0.0100"
