import numpy as np
import pytest

from pipeline.perception import motion_scores

TRUE_YAW, TRUE_SPEED = np.array([0.2, 0.2, 0.2, 0.2, 0.2]), np.array([6.0, 6.0, 6.0, 6.0, 0.2])
VALID = np.array([0, 1, 0, 1, 1], np.uint8)


def errors(yaw_error: float, ratio: float) -> motion_scores.Errors:
    return motion_scores.errors((TRUE_YAW + yaw_error) * VALID, TRUE_SPEED * ratio * VALID, VALID, TRUE_YAW, TRUE_SPEED)


def test_figures_are_those_of_the_frames_that_are_measured_and_not_too_slow() -> None:
    card = motion_scores.card([errors(0.01, 1.1)])
    assert card
    true, held = np.arctan(2.7 * 0.2 / 6), np.arctan(2.7 * 0.21 / 6.6)
    assert card == pytest.approx(
        {
            "frames": 5,
            "valid": 3 / 5,
            "yaw_rmse_degps": np.degrees(0.01),
            "yaw_median_degps": np.degrees(0.01),
            "speed_ratio": 1.1,
            "nmse": (held - true) ** 2 / true**2,  # frames 1 to 3: the first is not measured yet, the last too slow
        }
    )
    assert "60% measured, yaw rate to 0.57 deg/s, speed x 1.100, steering nmse" in motion_scores.summary_line(card)


def test_drives_are_judged_together_frame_by_frame() -> None:
    card = motion_scores.card([errors(0.01, 1.0), errors(0.03, 1.0), errors(0.03, 1.0)])
    assert card
    assert card["yaw_rmse_degps"] == pytest.approx(np.degrees(np.sqrt((0.01**2 + 2 * 0.03**2) / 3)))
    assert card["frames"] == 15


def test_what_cannot_be_told_is_none() -> None:
    nothing = np.zeros(3)
    assert motion_scores.card([]) is None
    assert motion_scores.card([motion_scores.errors(*[nothing[:0]] * 5)]) is None
    card = motion_scores.card([motion_scores.errors(nothing, nothing, nothing, nothing, nothing)])
    assert card == {
        "frames": 3, "valid": 0, "yaw_rmse_degps": None, "yaw_median_degps": None, "speed_ratio": None, "nmse": None
    }  # fmt: skip
    assert "nothing" in motion_scores.summary_line(card)
