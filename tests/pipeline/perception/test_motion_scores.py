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


def test_drives_are_judged_together_frame_by_frame() -> None:
    scores = motion_scores.score([errors(0.01, 1.0), errors(0.03, 1.0), errors(0.03, 1.0)])
    assert scores
    assert scores["yaw_rmse_degps"] == pytest.approx(np.degrees(np.sqrt((0.01**2 + 2 * 0.03**2) / 3)))
    assert (scores["drives"], scores["frames"], scores["judged"]) == (3, 15, 9)


def test_undefined_scores_are_none() -> None:
    nothing = np.zeros(3)
    assert motion_scores.score([]) is None
    assert motion_scores.score([motion_scores.errors(*[nothing[:0]] * 5, **CAR)]) is None
    scores = motion_scores.score([motion_scores.errors(*[nothing] * 5, **CAR)])
    assert scores == {
        "drives": 1, "frames": 3, "valid": 0, "judged": 0,
        "yaw_rmse_degps": None, "yaw_median_degps": None, "speed_ratio": None, "nmse": None
    }  # fmt: skip
    assert "no measured frame" in motion_scores.summary_line(scores)


def test_wheelbase_and_minimum_speed_are_those_of_the_labels() -> None:
    assert errors(0.0, 1.0, wheelbase_m=3.0).true_rad == pytest.approx([np.arctan(3.0 * 0.2 / 6)] * 3)
    assert len(errors(0.0, 1.0, min_speed_mps=0.1).true_rad) == 4
    assert not len(errors(0.0, 1.0, min_speed_mps=7.0).yaw_radps)


def test_a_drive_without_measurement_counts_only_as_frames() -> None:
    nothing = motion_scores.errors(0 * TRUE_YAW, 0 * TRUE_SPEED, 0 * VALID, TRUE_YAW, TRUE_SPEED, **CAR)
    one, both = motion_scores.score([errors(0.01, 1.1)]), motion_scores.score([errors(0.01, 1.1), nothing])
    assert one
    assert both == one | {"drives": 2, "frames": 10, "valid": 0.3}
