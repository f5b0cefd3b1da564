import json

import numpy as np
import pytest

from pipeline.camera import classes
from pipeline.encoder.truth import Truth
from pipeline.perception.depth_scale import MODES
from pipeline.perception.ground_plane import ground_plane_depth
from pipeline.perception.scores import (
    DEPTH_SCORES,
    Scores,
    class_ious,
    confusion,
    depth_errors,
    eigen_crop,
    mean_iou,
    pixel_accuracy,
    summary_line,
)
from tests import street


def test_depth_errors_equal_hand_values_and_skip_what_is_out_of_range() -> None:
    truth = np.array([[10.0, 20.0, 0.0, 0.9, 81.0, 40.0]])
    predicted = np.array([[11.0, 30.0, 5.0, 5.0, 5.0, 40.0]])
    errors = depth_errors(predicted, truth)
    assert errors is not None
    np.testing.assert_allclose(errors, [(0.1 + 0.5 + 0) / 3, np.sqrt((1 + 100 + 0) / 3), 2 / 3])


def test_depth_prediction_is_clipped_to_the_range() -> None:
    errors = depth_errors(np.array([1000.0, 0.1]), np.array([80.0, 1.0]))
    np.testing.assert_allclose(errors, [0, 0, 1])


def test_depth_errors_without_truth_or_prediction_are_none() -> None:
    assert depth_errors(np.ones((2, 2)), np.zeros((2, 2))) is None
    assert depth_errors(np.zeros((2, 2)), np.full((2, 2), 9.0)) is None
    assert depth_errors(np.array([0.0, 9.0]), np.array([9.0, 0.0])) is None


def test_holes_in_the_prediction_do_not_count() -> None:
    truth = np.array([[10.0, 20.0, 40.0]])
    errors = depth_errors(np.array([[11.0, 0.0, 40.0]]), truth)
    np.testing.assert_allclose(errors, [(0.1 + 0) / 2, np.sqrt((1 + 0) / 2), 1])
    scores = Scores()
    for predicted in (truth, np.zeros_like(truth)):
        scores.add_depth("depth_lidar", predicted, truth)
    perfect = {"frames": 1, "abs_rel": 0.0, "rmse_m": 0.0, "delta1": 1.0}
    assert scores.report()["depth_lidar"] == {**perfect, "coverage": 0.5}  # of the pixels of both frames


def test_coverage_is_the_share_of_true_depths_in_range_that_have_a_prediction() -> None:
    truth = np.array([[10.0, 20.0, 0.5, 0.0, 90.0, 30.0, 40.0]])
    scores = Scores()
    scores.add_depth("depth_dense", np.array([[10.0, 0.0, 1.0, 9.0, 9.0, 30.0, 0.0]]), truth)
    scores.add_depth("depth_dense", truth, truth)
    assert scores.report()["depth_dense"]["coverage"] == pytest.approx((2 + 4) / 8)


def test_flat_ground_is_scored_where_the_encoder_has_a_depth_and_nowhere_else() -> None:
    _, depth_m, cls = street.scene(0)
    rng = np.random.default_rng(0)
    stored = np.where(rng.random(street.SIZE) < 0.3, 0, depth_m)
    truth = Truth(depth_m, "dense", cls, has_cls=True)
    scores = Scores()
    scores.add_frame(stored, cls, street.K, truth, MODES["metric"], 1.65)
    report = scores.report()
    flat = np.where(stored > 0, ground_plane_depth(cls, street.K, 1.65), 0)
    assert report["depth_dense"]["abs_rel"] == 0
    assert report["ground_plane_dense"]["abs_rel"] == pytest.approx(depth_errors(flat, depth_m)[0])
    assert 0.5 < report["depth_dense"]["coverage"] == report["ground_plane_dense"]["coverage"] < 0.8
    assert report["depth_lidar"] is None
    assert report["classes"]["pixel_accuracy"] == 1
    line = summary_line(report)
    assert "abs rel 0.000" in line
    assert "mean IoU 1.000" in line


def test_depth_of_an_unknown_unit_is_scored_by_its_ratios() -> None:
    _, depth_m, cls = street.scene(0)
    truth = Truth(depth_m, "lidar", cls, has_cls=False)
    scores = Scores()
    scores.add_frame(0.2 * depth_m, cls, street.K, truth, MODES["none"], 1.65)
    assert scores.report()["depth_lidar"]["abs_rel"] == pytest.approx(0, abs=1e-9)
    assert scores.report()["classes"] is None


def test_confusion_counts_pairs_and_leaves_void_out() -> None:
    truth = np.array([0, 0, 0, 1, 1, classes.VOID, 18])
    predicted = np.array([0, 0, 1, 1, 2, 5, 18], np.uint8)
    matrix = confusion(predicted, truth)
    assert matrix.sum() == 6
    assert (matrix[0, 0], matrix[0, 1], matrix[1, 1], matrix[1, 2], matrix[18, 18]) == (2, 1, 1, 1, 1)
    ious = class_ious(matrix)
    np.testing.assert_allclose(ious[[0, 1, 18]], [2 / 3, 1 / 3, 1])
    assert np.isnan(ious[2])  # predicted, but nowhere in the truth
    assert mean_iou(matrix) == pytest.approx((2 / 3 + 1 / 3 + 1) / 3)
    assert pixel_accuracy(matrix) == pytest.approx(4 / 6)


def test_empty_confusion_has_no_score() -> None:
    empty = np.zeros((19, 19), int)
    assert np.isnan(mean_iou(empty))
    assert np.isnan(pixel_accuracy(empty))


def test_scores_add_up_over_drives_and_are_plain_json() -> None:
    rng = np.random.default_rng(0)
    whole, total = Scores(), Scores()
    for _ in range(2):
        part = Scores()
        for _ in range(3):
            depth, truth = rng.uniform(2, 60, (2, 5, 6))
            cls, true_cls = rng.integers(0, 4, (2, 5, 6))
            for scores in (whole, part):
                scores.add_depth("depth_dense", depth, truth)
                scores.add_classes(cls, true_cls)
        total.add_sums(json.loads(json.dumps(part.sums())))
    assert total.report()["depth_dense"] == pytest.approx(whole.report()["depth_dense"])
    assert total.report()["classes"] == whole.report()["classes"]
    assert whole.report()["depth_dense"]["frames"] == 6
    assert list(whole.report()["classes"]["iou"]) == list(classes.NAMES[:4])


def test_what_has_no_truth_is_null_in_json() -> None:
    scores = Scores()
    scores.add_depth("depth_lidar", np.ones((2, 2)), np.zeros((2, 2)))
    report = json.loads(json.dumps(scores.report(), allow_nan=False))
    assert set(report) == {*DEPTH_SCORES, *(f"{key}_eigen" for key in DEPTH_SCORES), "classes"}
    assert set(report.values()) == {None}


def test_the_crop_is_that_of_monodepth_on_kittis_image() -> None:
    rows, columns = np.mgrid[:375, :1242]
    assert (eigen_crop(rows).min(), eigen_crop(rows).max() + 1) == (124, 342)
    assert (eigen_crop(columns).min(), eigen_crop(columns).max() + 1) == (44, 1197)


def test_what_lies_outside_the_crop_counts_for_the_whole_image_alone() -> None:
    truth = np.full((100, 100), 10.0)
    predicted = truth.copy()
    predicted[:33] = 20.0  # above the crop
    scores = Scores()
    scores.add_depth("depth_lidar", predicted, truth)
    truth[33:91] = 0.0  # nothing is known within the crop
    scores.add_depth("depth_lidar", predicted, truth)
    report = scores.report()
    assert report["depth_lidar"]["frames"] == 2
    assert report["depth_lidar"]["abs_rel"] == pytest.approx((0.33 + 33 / 42) / 2)
    crop = report["depth_lidar_eigen"]
    assert crop == {"frames": 1, "abs_rel": 0.0, "rmse_m": 0.0, "delta1": 1.0, "coverage": 1.0}
