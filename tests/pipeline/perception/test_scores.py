import json

import numpy as np
import pytest

from pipeline.camera import classes
from pipeline.perception.depth_scale import ground_plane_depth
from pipeline.perception.scores import (
    DEPTH_SCORES,
    Scores,
    class_ious,
    confusion,
    depth_errors,
    summary_line,
)
from pipeline.perception.truth import Truth
from tests import street


@pytest.mark.parametrize(
    ("truth", "predicted", "expected"),
    [
        ([10, 20, 0, 0.9, 81, 40], [11, 30, 5, 5, 5, 40], [(0.1 + 0.5) / 3, np.sqrt(101 / 3), 2 / 3]),  # out of range
        ([80, 1], [1000, 0.1], [0, 0, 1]),  # clipped
        ([10, 20, 40], [11, 0, 40], [0.05, np.sqrt(1 / 2), 1]),  # a hole in the prediction
    ],
)
def test_depth_errors_equal_hand_values(truth: list[float], predicted: list[float], expected: list[float]) -> None:
    np.testing.assert_allclose(depth_errors(np.array(predicted), np.array(truth, float)), expected)


def test_flat_ground_is_scored_at_the_pixels_of_the_encoder() -> None:
    _, depth_m, cls = street.scene(0)
    stored = np.where(np.random.default_rng(0).random(street.SIZE) < 0.3, 0, depth_m)
    scores = Scores()
    scores.add_frame(stored, cls, street.CAMERA, Truth(depth_m, "dense", cls, has_cls=True))
    report = scores.report()
    flat = np.where(stored > 0, ground_plane_depth(cls, street.CAMERA), 0)
    assert report["depth_dense"]["abs_rel"] == 0
    assert report["ground_plane_dense"]["abs_rel"] == pytest.approx(depth_errors(flat, depth_m)[0])
    assert 0.5 < report["depth_dense"]["coverage"] == report["ground_plane_dense"]["coverage"] < 0.8
    assert report["depth_lidar"] is None
    assert report["classes"]["pixel_accuracy"] == 1
    assert "abs rel 0.000" in summary_line(report)
    assert "mean IoU 1.000" in summary_line(report)


def test_class_scores_equal_hand_values() -> None:
    truth = np.array([0, 0, 0, 1, 1, classes.VOID, 18])
    matrix = confusion(np.array([0, 0, 1, 1, 2, 5, 18], np.uint8), truth)
    assert (matrix.sum(), matrix[0, 0], matrix[0, 1], matrix[1, 1], matrix[1, 2], matrix[18, 18]) == (6, 2, 1, 1, 1, 1)
    ious = class_ious(matrix)
    np.testing.assert_allclose(ious[[0, 1, 18]], [2 / 3, 1 / 3, 1])
    assert np.isnan(ious[2])  # predicted, but not in the truth
    scores = Scores()
    scores.confusion += matrix
    report = scores.report()["classes"]
    assert report["mean_iou"] == pytest.approx((2 / 3 + 1 / 3 + 1) / 3)
    assert report["pixel_accuracy"] == pytest.approx(4 / 6)


def test_predicted_void_is_an_error_of_the_true_class() -> None:
    truth = np.array([0, 0, 18, 18, classes.VOID])
    scores = Scores()
    scores.add_classes(np.array([0, classes.VOID, classes.VOID, 18, classes.VOID], np.uint8), truth)
    assert scores.report()["classes"]["pixel_accuracy"] == 0.5
    assert scores.report()["classes"]["iou"] == {classes.NAMES[0]: 0.5, classes.NAMES[18]: 0.5}


def test_scores_add_up_over_drives_through_json() -> None:
    rng = np.random.default_rng(0)
    every, total = Scores(), Scores()
    for _ in range(2):
        part = Scores()
        for _ in range(3):
            depth, truth = rng.uniform(2, 60, (2, 5, 6))
            cls, true_cls = rng.integers(0, 4, (2, 5, 6))
            for scores in (every, part):
                scores.add_depth("depth_dense", depth, truth)
                scores.add_classes(cls, true_cls)
        total.add_sums(json.loads(json.dumps(part.sums())))
    assert total.report()["depth_dense"] == pytest.approx(every.report()["depth_dense"])
    assert total.report()["classes"] == every.report()["classes"]
    assert list(every.report()["classes"]["iou"]) == list(classes.NAMES[:4])
    empty = json.loads(json.dumps(Scores().report(), allow_nan=False))
    assert set(empty) == {*DEPTH_SCORES, *(f"{key}_eigen" for key in DEPTH_SCORES), "classes"}
    assert set(empty.values()) == {None}
