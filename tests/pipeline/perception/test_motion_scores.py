import numpy as np
import pytest

from pipeline.perception import motion_scores

TRUE_YAW, TRUE_SPEED = np.array([0.2, 0.2, 0.2, 0.2, 0.2]), np.array([6.0, 6.0, 6.0, 6.0, 0.2])
VALID = np.array([0, 1, 0, 1, 1], np.uint8)


CAR = {"wheelbase_m": 2.7, "min_speed_mps": 1.0}


def errors(yaw_error: float, ratio: float, **car: float) -> motion_scores.Errors:
    return motion_scores.errors(
        (TRUE_YAW + yaw_error) * VALID, TRUE_SPEED * ratio * VALID, VALID, TRUE_YAW, TRUE_SPEED, **(CAR | car)
    )


def test_scores_use_measured_frames_above_the_minimum_speed() -> None:
    scores = motion_scores.score([errors(0.01, 1.1)])
    assert scores
    true, held = np.arctan(2.7 * 0.2 / 6), np.arctan(2.7 * 0.21 / 6.6)
    assert scores == pytest.approx(
        {
            "drives": 1,
            "frames": 5,
            "valid": 3 / 5,
            "judged": 3,
            "yaw_rmse_degps": np.degrees(0.01),
            "yaw_median_degps": np.degrees(0.01),
            "speed_ratio": 1.1,
            "nmse": (held - true) ** 2 / true**2,  # frames 1 to 3: the first is not measured yet, the last too slow
        }
    )
    assert (
        "60% of 5 frames measured, yaw rate to 0.57 deg/s, speed x 1.100, steering nmse"
        in motion_scores.summary_line(scores)
    )
