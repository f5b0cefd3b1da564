"""Errors of depth and classes, and of measured motion."""

import json

import numpy as np
import pytest

from pipeline.camera import classes
from pipeline.camera.ground_plane import ground_plane_depth
from pipeline.ingest.packets import make_rows
from pipeline.ingest.truth import Truth
from pipeline.labels import label
from pipeline.labels.label import Car, Labels
from pipeline.scores.motion_scores import label_errors, score, score_motion
from pipeline.scores.pixels import Scores, depth_errors, eigen_crop
from tests import street
from tests.artefacts import write_motion, write_recorded


@pytest.mark.parametrize(
    ("truth", "predicted", "expected"),
    [
        # out of range
        (
            [10, 20, 0, 0.9, 81, 40],
            [11, 30, 5, 5, 5, 40],
            [(0.1 + 0.5) / 3, np.sqrt(101 / 3), 2 / 3],
        ),
        ([80, 1], [1000, 0.1], [0, 0, 1]),  # clipped
        ([10, 20, 40], [11, 0, 40], [0.05, np.sqrt(1 / 2), 1]),  # a hole in the prediction
    ],
)
def test_depth_errors_equal_hand_values(truth, predicted, expected):
    np.testing.assert_allclose(depth_errors(np.array(predicted), np.array(truth, float)), expected)


def test_flat_ground_is_scored_at_the_pixels_of_the_encoder():
    _, depth_m, cls = street.scene(0)
    stored = np.where(np.random.default_rng(0).random(street.SIZE) < 0.3, 0, depth_m)
    scores = Scores()
    scores.add_frame(stored, cls, street.CAMERA, Truth(depth_m, "dense", cls))
    report = scores.report()
    flat = np.where(stored > 0, ground_plane_depth(cls, street.CAMERA), 0)
    assert report["depth_dense"]["abs_rel"] == 0
    error, *_ = depth_errors(eigen_crop(flat), eigen_crop(depth_m))
    assert report["ground_plane_dense"]["abs_rel"] == pytest.approx(error)
    assert 0.5 < report["depth_dense"]["coverage"] == report["ground_plane_dense"]["coverage"] < 0.8
    assert report["depth_lidar"] is None
    assert report["classes"]["pixel_accuracy"] == 1
    assert report["classes"]["mean_iou"] == 1


def test_class_scores_equal_hand_values():
    scores = Scores()
    truth = np.array([0, 0, 0, 1, 1, classes.VOID, 18, 18])
    # void is an error
    scores.add_classes(np.array([0, 0, 1, 1, 2, 5, 18, classes.VOID], np.uint8), truth)
    report = scores.report()["classes"]
    # 2 is not in the truth
    ious = {classes.NAMES[0]: 2 / 3, classes.NAMES[1]: 1 / 3, classes.NAMES[18]: 1 / 2}
    assert report["iou"] == pytest.approx(ious)
    assert report["mean_iou"] == pytest.approx(1 / 2)
    assert report["pixel_accuracy"] == pytest.approx(4 / 7)


def test_scores_add_up_over_drives_through_json():
    rng, every, total = np.random.default_rng(0), Scores(), Scores()
    for _ in range(2):
        part, (depth, truth), (cls, true_cls) = (
            Scores(),
            rng.uniform(2, 60, (2, 5, 6)),
            rng.integers(0, 4, (2, 5, 6)),
        )
        for scores in (every, part):
            scores.add_depth("depth_dense", depth, truth)
            scores.add_classes(cls, true_cls)
        total.add(json.loads(json.dumps({key: sums.tolist() for key, sums in part.sums.items()})))
    assert total.report()["depth_dense"] == pytest.approx(every.report()["depth_dense"])
    assert total.report()["classes"] == every.report()["classes"]
    assert set(Scores().report().values()) == {None}


DRIVE = "2027_03_31_drive_0001"
FRAMES = 20
SPEED_MPS = 10.0
YAW_RATE_RADPS = 0.2
TRUE_RAD = float(np.arctan(2.7 * YAW_RATE_RADPS / SPEED_MPS))
L = 2.7


CAR = label.Car(L, 1.0)


def moved(yaw_rate: float, speed: float, measured: list[int]) -> Labels:
    """Return the labels of five frames, of which the last is slow."""
    rates = yaw_rate * np.array(measured), speed * np.array([1, 1, 1, 1, 0.03]) * measured
    labels = label.steering_labels(*rates, CAR)
    return labels._replace(valid=labels.valid & np.array(measured, bool))


def test_scores_use_measured_frames_above_the_minimum_speed():
    true, held = np.arctan(L * 0.2 / 6), np.arctan(L * 0.21 / 6.6)
    scores = score([label_errors(moved(0.21, 6.6, [0, 1, 0, 1, 1]), moved(0.2, 6.0, [1] * 5))])
    expected = {"drives": 1, "frames": 5, "valid": 2 / 5, "judged": 3, "speed_ratio": 1.1}
    expected |= dict.fromkeys(("yaw_rmse_degps", "yaw_median_degps"), np.degrees(0.01))
    # frames 1 to 3: the first is not measured yet, the last too slow
    expected["nmse"] = (held - true) ** 2 / true**2
    assert scores == pytest.approx(expected)
    assert score([]) is None
    true, unknown = moved(0.2, 6.0, [1] * 5), np.full(5, np.nan)
    wheel = Labels(1.1 * true.steering_rad, true.valid, unknown, unknown)
    scores = score([label_errors(wheel, true)])
    assert (scores["yaw_rmse_degps"], scores["speed_ratio"], scores["nmse"]) == (
        None,
        None,
        pytest.approx(0.01),
    )


@pytest.mark.parametrize("with_oxts", [False, True])
@pytest.mark.parametrize("with_wheel", [False, True])
def test_only_recorded_values_are_a_reference(tmp_path, with_oxts, with_wheel):
    """The measured speed is 10 % too high, and the recorded angle 0.01 rad off."""
    oxts = make_rows(FRAMES, vf=SPEED_MPS, wu=YAW_RATE_RADPS) if with_oxts else None
    angles = dict.fromkeys(range(FRAMES), TRUE_RAD + 0.01) if with_wheel else None
    write_recorded(tmp_path / f"ingest/{DRIVE}.h5", np.arange(FRAMES), oxts, angles)
    write_motion(
        tmp_path / "motion", DRIVE, dict.fromkeys(range(FRAMES), (1.1 * SPEED_MPS, YAW_RATE_RADPS))
    )
    found = score_motion(
        [DRIVE], ingest=tmp_path / "ingest", motion=tmp_path / "motion", car=Car(2.7, 1.0)
    )
    compared = {"visual": with_oxts, "visual-wheel": with_wheel, "wheel": with_oxts and with_wheel}
    assert set(found) == {kind for kind, expected in compared.items() if expected}
    for kind, result in found.items():
        assert result["judged"] == FRAMES
        # a wheel has neither speed nor yaw rate, whatever its labels borrow
        with_rates = kind == "visual"
        assert result["speed_ratio"] == (pytest.approx(1.1) if with_rates else None), kind
        assert (result["yaw_rmse_degps"] is None) == (not with_rates), kind
        assert 0 < result["nmse"] < 0.1
