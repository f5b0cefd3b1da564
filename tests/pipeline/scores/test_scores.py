"""Test the scores of depth and classes, and of measured motion."""

import json

import numpy as np
import pytest

from pipeline.camera import classes
from pipeline.camera.ground_plane import ground_plane_depth
from pipeline.ingest.packets import make_packets
from pipeline.ingest.truth import Truth
from pipeline.labels import label
from pipeline.labels.label import Car
from pipeline.labels.label_file import Labels
from pipeline.scores.motion_scores import compare_labels, score_motion, summarise_errors
from pipeline.scores.pixels import Scores, compute_depth_errors, crop_eigen
from pipeline.scores.score import score_splits
from tests import street
from tests.artefacts import write_motion, write_recorded


@pytest.mark.parametrize(
    ("truth", "predicted", "abs_rel", "rmse_m", "delta1"),
    [
        # The third to fifth true depth are out of range.
        ([10, 20, 0, 0.9, 81, 40], [11, 30, 5, 5, 5, 40], 0.6 / 3, np.sqrt(101 / 3), 2 / 3),
        ([80, 1], [1000, 0.1], 0, 0, 1),  # clipped
        ([10, 20, 40], [11, 0, 40], 0.05, np.sqrt(1 / 2), 1),  # a hole in the prediction
    ],
)
def test_depth_errors_equal_hand_values(truth, predicted, abs_rel, rmse_m, delta1):
    errors = compute_depth_errors(np.array(predicted), np.array(truth, float))
    np.testing.assert_allclose(errors, [abs_rel, rmse_m, delta1])


def test_flat_ground_is_scored_at_the_pixels_of_the_encoder():
    _, depth_m, cls = street.scene(0)
    stored = np.where(np.random.default_rng(0).random(street.SIZE) < 0.3, 0, depth_m)
    scores = Scores()
    scores.add_frame(stored, cls, street.CAMERA, Truth(depth_m, "dense", cls))
    report = scores.to_report()
    flat = np.where(stored > 0, ground_plane_depth(cls, street.CAMERA), 0)
    assert report["depth_dense"]["abs_rel"] == 0
    error, *_ = compute_depth_errors(crop_eigen(flat), crop_eigen(depth_m))
    assert report["ground_plane_dense"]["abs_rel"] == pytest.approx(error)
    assert 0.5 < report["depth_dense"]["coverage"] == report["ground_plane_dense"]["coverage"] < 0.8
    assert report["depth_lidar"] is None
    assert report["classes"]["pixel_accuracy"] == 1
    assert report["classes"]["mean_iou"] == 1


def test_class_scores_equal_hand_values():
    scores = Scores()
    # Class 2 is not in the truth, and a predicted void is an error.
    truth = np.array([0, 0, 0, 1, 1, classes.VOID, 18, 18])
    predicted = np.array([0, 0, 1, 1, 2, 5, 18, classes.VOID], np.uint8)
    scores.add_classes(predicted, truth)
    report = scores.to_report()["classes"]
    ious = {classes.NAMES[0]: 2 / 3, classes.NAMES[1]: 1 / 3, classes.NAMES[18]: 1 / 2}
    assert report["iou"] == pytest.approx(ious)
    assert report["mean_iou"] == pytest.approx(1 / 2)
    assert report["pixel_accuracy"] == pytest.approx(4 / 7)


def test_scores_add_up_over_drives_through_json():
    rng = np.random.default_rng(0)
    of_both = Scores()
    added = Scores()
    for _ in range(2):
        of_drive = Scores()
        depth_m, true_depth_m = rng.uniform(2, 60, (2, 5, 6))
        cls, true_cls = rng.integers(0, 4, (2, 5, 6))
        for scores in (of_both, of_drive):
            scores.add_depth("depth_dense", depth_m, true_depth_m)
            scores.add_classes(cls, true_cls)
        text = json.dumps({key: sums.tolist() for key, sums in of_drive.sums.items()})
        added.add_sums(json.loads(text))
    assert added.to_report()["depth_dense"] == pytest.approx(of_both.to_report()["depth_dense"])
    assert added.to_report()["classes"] == of_both.to_report()["classes"]
    assert set(Scores().to_report().values()) == {None}


DRIVES = ["2027_03_31_drive_0001", "2027_03_31_drive_0002"]
FRAMES = 20
SPEED_MPS = 10.0
YAW_RATE_RADPS = 0.2
L = 2.7
CAR = Car(L, 1.0)


def moved(yaw_rate: float, speed: float, measured: list[int]) -> Labels:
    """Return the labels of five frames, of which the last is slow."""
    yaw_rates = yaw_rate * np.array(measured)
    speeds = speed * np.array([1, 1, 1, 1, 0.03]) * measured
    labels = label.steering_labels(yaw_rates, speeds, CAR)
    return labels._replace(valid=labels.valid & np.array(measured, bool))


def test_scores_use_measured_frames_above_the_minimum_speed():
    measured = moved(0.21, 6.6, [0, 1, 0, 1, 1])
    scores = summarise_errors([compare_labels(measured, moved(0.2, 6.0, [1] * 5))])
    true_rad = np.arctan(L * 0.2 / 6)
    measured_rad = np.arctan(L * 0.21 / 6.6)
    # Frames 1 to 3 are compared: the first is not measured yet, the last is too slow.
    expected = {
        "drives": 1,
        "frames": 5,
        "valid": 2 / 5,
        "judged": 3,
        "speed_ratio": 1.1,
        "yaw_rmse_degps": np.degrees(0.01),
        "yaw_median_degps": np.degrees(0.01),
        "nmse": (measured_rad - true_rad) ** 2 / true_rad**2,
    }
    assert scores == pytest.approx(expected)
    assert summarise_errors([]) is None


def test_only_recorded_motion_is_a_reference(tmp_path):
    """The measured speed is 10 % too high, and the second drive recorded angles only."""
    packets = make_packets(FRAMES, vf=SPEED_MPS, wu=YAW_RATE_RADPS)
    angles = dict.fromkeys(range(FRAMES), 0.1)
    motion = dict.fromkeys(range(FRAMES), (1.1 * SPEED_MPS, YAW_RATE_RADPS))
    for drive, oxts in zip(DRIVES, (packets, None), strict=True):
        write_recorded(tmp_path / f"ingest/{drive}.h5", np.arange(FRAMES), oxts, angles)
        write_motion(tmp_path / "motion", drive, motion)

    scores = score_motion(DRIVES, tmp_path / "ingest", tmp_path / "motion", CAR)
    assert scores["drives"] == 1
    assert scores["judged"] == FRAMES
    assert 0 < scores["nmse"] < 0.1
    assert scores["speed_ratio"] == pytest.approx(1.1)
    assert score_motion(DRIVES[1:], tmp_path / "ingest", tmp_path / "motion", CAR) is None


def test_logs_of_test_drives_have_lines_of_their_own_which_advise_no_offset(tmp_path):
    """Both logs are a frame late. Frames of measured motion are 10 s apart."""
    count = 100
    yaw_rate = np.random.default_rng(0).normal(0, 0.3, count)
    motion = {row: (SPEED_MPS, value) for row, value in enumerate(yaw_rate)}
    packets = make_packets(count, vf=SPEED_MPS, wu=np.roll(yaw_rate, 1))
    for drive in DRIVES:
        write_recorded(tmp_path / f"ingest/{drive}.h5", np.arange(count), packets)
        write_motion(tmp_path / "motion", drive, motion)

    sums = {key: values.tolist() for key, values in Scores().sums.items()}
    splits = dict(zip(DRIVES, ("train", "test"), strict=True))
    content = score_splits(
        splits, {DRIVES[1]: {"sums": sums}}, tmp_path / "ingest", tmp_path / "motion", CAR
    )
    recorded = content["recorded"]
    late = "correlation 1.00 with the measured one at a lag of +10.00 s (the log is late"
    assert f"{late}: --offset -10.00)" in recorded[f"yaw_rate of {DRIVES[0]}"]["line"]
    assert (
        f"{late}: --offset -10.00)"
        in (recorded["yaw_rate of training and validation drives"]["line"])
    )
    assert f"{late})" in recorded[f"yaw_rate of {DRIVES[1]}"]["line"]
    assert f"{late})" in recorded["yaw_rate of test drives"]["line"]
    assert recorded["speed of test drives"]["ratio"] == pytest.approx(1)
