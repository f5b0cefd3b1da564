"""The sentences of the page, complete, in twelve cases of labels, models and roads."""

from pathlib import Path
from typing import Any

import pytest

from pipeline.report.story import sentences
from tests.pipeline.report import examples


def model(name: str = "net", nmse: float = 0.2, *, labels: str = "oxts", **odometry: Any) -> dict[str, Any]:
    """Return the metrics.json of a model; `odometry`: nmse of odometry and regression, `factor`, and settings."""
    factor = odometry.pop("factor", 1.0)
    baselines = {name: odometry.pop(name) for name in ("odometry", "regression") if name in odometry}
    content = examples.metrics(name, nmse, baselines, **odometry) | {"labels": labels}
    return content | {"odometry": {"kind": "visual", "coefficient": factor} if baselines else None}


def straight(content: dict[str, Any]) -> dict[str, Any]:
    """Leave frames only in the first bin, where the model is worse than zero."""
    first, *bends = content["test"]["by_curvature"]
    empty = [{"from_1pm": row["from_1pm"], "to_1pm": row["to_1pm"], "frames": 0} for row in bends]
    content["test"]["by_curvature"] = [first | examples.errors(2.0) | {"nmse_ci95": [1.5, 2.5]}, *empty]
    return content


def without_angles(content: dict[str, Any]) -> dict[str, Any]:
    """Leave no angle but 0 in the first bin."""
    first = content["test"]["by_curvature"][0]
    first |= {"nmse": None, "nmse_ci95": None, "zero": examples.errors(0.0) | {"nmse": None}}
    return content


def one_drive(content: dict[str, Any]) -> dict[str, Any]:
    return content | {"drives": {"train": ["one"], "val": [], "test": ["one"]}}


GOOD = (
    "net predicts the steering angle with a mean error of 1.8° and beats always predicting zero: it has "
    "20 % of the squared error of zero (95 % interval 10 % to 30 %)."
)
BENDS = (
    "In bends (|curvature| 0.03 to 0.1 1/m) it beats always predicting zero: RMSE 5.1°, zero has 17.2°; "
    "on straight road (|curvature| 0 to 0.03 1/m) it beats always predicting zero: RMSE 2.6°, zero has "
    "5.7°."
)
AHEAD = (
    "Try next in params.yaml: horizon: 10, an angle ahead of the car, which no odometry can measure; and "
    "more training drives with bends like those of the test drives (ingest.drives)."
)
CASES: dict[str, tuple[list[dict[str, Any]], list[str]]] = {
    "sample": (
        [model("weak", 0.9, odometry=0.02, regression=0.02), model("best", odometry=0.02, regression=0.02)],
        [
            "best predicts the steering angle with a mean error of 1.8° and beats always predicting zero: it has "
            "20 % of the squared error of zero (95 % interval 10 % to 30 %).",
            "It has the lowest error of 2 models.",
            "It is worse than odometry, which needs no learning and has 2 % of the squared error of zero.",
            BENDS,
            "Try next in params.yaml: motion: visual, so that the network corrects the odometry angle instead of "
            "replacing it; and more training drives with bends like those of the test drives (ingest.drives).",
        ],
    ),
    "wheel": (
        [model(labels="wheel", odometry=2.4, regression=0.08, factor=0.38)],
        [
            GOOD,
            "Odometry follows the angle but is off by a constant factor: it fits best multiplied by 0.38 "
            "(regression on the training drives). Set the field of view (steer import --fov) and the camera's "
            "height (perception.camera_height_m), and check the steering ratio (steer import --steering-ratio).",
            "It is worse than odometry times 0.38, which needs no learning and has 8 % of the squared error of zero.",
            BENDS,
            AHEAD,
        ],
    ),
    "visual": (
        [model(labels="visual")],
        [
            GOOD,
            "The labels are measured motion themselves, so there is no odometry to compare with.",
            BENDS,
            AHEAD,
        ],
    ),
    "lidar": (
        [model(labels="lidar", odometry=0.01, regression=0.01)],
        [
            GOOD,
            "It is worse than odometry, which needs no learning and has 1 % of the squared error of zero.",
            BENDS,
            "Try next in params.yaml: motion: visual, so that the network corrects the odometry angle instead of "
            "replacing it; and more training drives with bends like those of the test drives (ingest.drives).",
        ],
    ),
    "one drive": (
        [one_drive(model(odometry=0.25, regression=0.25))],
        [
            GOOD,
            "All test frames are of one drive, so the intervals say little about other roads.",
            "It is not shown to be better than odometry, which has 25 % of the squared error of zero.",
            BENDS,
            AHEAD,
        ],
    ),
    "a straight road": (
        [straight(model(odometry=0.5, regression=0.5))],
        [
            GOOD,
            "It beats odometry, which has 50 % of the squared error of zero.",
            "On straight road (|curvature| 0 to 0.03 1/m) it is worse than always predicting zero: RMSE 8.1°, "
            "zero has 5.7°.",
            "The test drives have no bends, so its error there is unknown.",
            "Try next in params.yaml: equivariant: true, so that a mirrored scene gives the opposite angle and a "
            "straight road no bias; and test drives with bends (ingest.drives).",
        ],
    ),
    "no classes": (
        [model(odometry=0.4, regression=0.4, semantics=0.0, input="depth")],
        [
            GOOD,
            "It beats odometry, which has 40 % of the squared error of zero.",
            BENDS,
            AHEAD,
        ],
    ),
    "no odometry": (
        [model()],
        [
            GOOD,
            "There is no odometry to compare with.",
            BENDS,
            AHEAD,
        ],
    ),
    "worse than zero": (
        [model(nmse=2.4, odometry=3.5, regression=0.9, factor=0.2)],
        [
            "net predicts the steering angle with a mean error of 6.2° and is worse than always predicting zero: "
            "it has 240 % of the squared error of zero (95 % interval 120 % to 360 %).",
            "Odometry is no better than zero: it has 350 % of its squared error.",
            "In bends (|curvature| 0.03 to 0.1 1/m) it is not shown to be better than always predicting zero: "
            "RMSE 17.8°, zero has 17.2°; on straight road (|curvature| 0 to 0.03 1/m) it is worse than always "
            "predicting zero: RMSE 8.9°, zero has 5.7°.",
            "Try next in params.yaml: equivariant: true, so that a mirrored scene gives the opposite angle and a "
            "straight road no bias; and more training drives with bends like those of the test drives "
            "(ingest.drives).",
        ],
    ),
    "two models equal": (
        [model("one", odometry=0.6, regression=0.6), model("two", 0.21, odometry=0.6, regression=0.6)],
        [
            "one predicts the steering angle with a mean error of 1.8° and beats always predicting zero: it has "
            "20 % of the squared error of zero (95 % interval 10 % to 30 %).",
            "It has the lowest error of 2 models, but is not shown to be better than two.",
            "It beats odometry, which has 60 % of the squared error of zero.",
            BENDS,
            AHEAD,
        ],
    ),
    "folds": (
        [model(odometry=0.02, regression=0.02, motion="visual", fit_to="others")],
        [
            GOOD,
            "Each test drive is predicted by a network that was not fitted to it.",
            "It is worse than odometry, which needs no learning and has 2 % of the squared error of zero.",
            BENDS,
            AHEAD,
        ],
    ),
    "a second ahead": (
        [model(nmse=0.9, odometry=0.6, regression=0.5, factor=0.7, horizon=10)],
        [
            "net predicts the steering angle 10 frames ahead with a mean error of 3.8° and is not shown to be "
            "better than always predicting zero: it has 90 % of the squared error of zero (95 % interval 45 % to "
            "135 %).",
            "It is not shown to be better than odometry, which has 60 % of the squared error of zero.",
            "In bends (|curvature| 0.03 to 0.1 1/m) it beats always predicting zero: RMSE 10.9°, zero has 17.2°; "
            "on straight road (|curvature| 0 to 0.03 1/m) it is not shown to be better than always predicting "
            "zero: RMSE 5.4°, zero has 5.7°.",
            "Try next in params.yaml: more training drives with bends like those of the test drives (ingest.drives).",
        ],
    ),
}


def test_a_bin_where_every_angle_is_0_has_no_verdict(tmp_path: Path) -> None:
    *_, bends, _ = sentences(examples.results(tmp_path, without_angles(model())))
    assert bends.endswith("; on straight road (|curvature| 0 to 0.03 1/m) it has RMSE 2.6°, zero has 0.0°.")


def test_without_an_interval_nothing_is_shown(tmp_path: Path) -> None:
    contents = [model(name, odometry=0.4, regression=0.4) for name in ("net", "second")]
    for content in contents:
        content["test"]["nmse_ci95"] = None
    accuracy, rank, odometry, *_ = sentences(examples.results(tmp_path, *contents))
    assert accuracy.endswith(
        "is not shown to be better than always predicting zero: it has 20 % of the squared error of zero (too short "
        "for an interval)."
    )
    assert rank == "It has the lowest error of 2 models, but is not shown to be better than second."
    assert odometry == "It is not shown to be better than odometry, which has 40 % of the squared error of zero."


def test_a_model_on_odometry_of_a_wrong_scale_gets_no_base(tmp_path: Path) -> None:
    content = model(odometry=2.4, regression=0.08, factor=0.38, motion="visual", base="motion")
    *_, step = sentences(examples.results(tmp_path, content))
    assert step.startswith("Try next in params.yaml: base: none, so that")


@pytest.mark.parametrize("name", CASES)
def test_the_sentences_are_complete(tmp_path: Path, name: str) -> None:
    contents, expected = CASES[name]
    assert sentences(examples.results(tmp_path, *contents)) == expected


def test_without_results_nothing_is_said(tmp_path: Path) -> None:
    content = examples.metrics("net")
    content["test"]["nmse"] = None
    assert sentences(examples.results(tmp_path, content)) == []
    assert sentences(examples.results(tmp_path)) == []
