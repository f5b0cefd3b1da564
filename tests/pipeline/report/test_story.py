"""The sentences of the page."""

from pathlib import Path
from typing import Any

import pytest

from pipeline.report.story import sentences
from tests.pipeline.report import examples
from tests.pipeline.report.examples import metrics

NONE = "the best row without learning"


@pytest.mark.parametrize(
    ("nmse", "baselines", "verdict"),
    [
        (0.2, {"zero": 1.0}, f"beats zero, {NONE} (1.000)."),
        (0.99, {"zero": 1.0}, f"is as good as zero, {NONE} (1.000)."),
        (0.2, {"odometry": 0.6, "regression": 0.4}, f"beats regression, {NONE} (0.400)."),
        (0.2, {"train_mean": 0.25}, f"is not shown to be better than train_mean, {NONE} (0.250): 80% of its"),
        (0.6, {"odometry": 0.05}, f"is worse than odometry, {NONE} (0.050): 12 times its squared error."),
        (1.2, {"zero": 1.0}, f"is worse than zero, {NONE} (1.000): 1.2 times its squared error."),
    ],
)
@pytest.mark.parametrize("predict", ["angle", "path"])
def test_the_best_model_is_compared_with_the_best_row_without_learning(
    tmp_path: Path, nmse: float, baselines: dict[str, float], verdict: str, predict: str
) -> None:
    models = metrics("worse", 3.0, baselines, predict=predict), metrics("net", nmse, baselines, predict=predict)
    (text,) = sentences(examples.groups(tmp_path, *models))
    title = {"angle": "steering angle", "path": "path ahead"}[predict]
    assert text.startswith(f"net predicts the {title} with a test nmse of {nmse:.3f} ({nmse / 2:.3f} to ")
    assert verdict in text


def test_without_an_interval_nothing_is_beaten(tmp_path: Path) -> None:
    content = metrics("net")
    content["test"]["steering_rad"]["nmse_ci95"] = None
    (text,) = sentences(examples.groups(tmp_path, content))
    assert "(too short for an interval) and is not shown to be better than zero" in text


@pytest.mark.parametrize(("gain", "inverted"), [(-1.19, True), (0.4, False), (None, False)])
def test_a_negative_gain_means_that_left_and_right_are_exchanged(tmp_path: Path, gain: Any, inverted: bool) -> None:
    content = metrics("net")
    content["columns"] = {"steering_rad": content["columns"]["steering_rad"] | {"odometry_gain": gain}}
    texts = sentences(examples.groups(tmp_path, content))
    assert ("The sign of wheel_rad is inverted: left is positive." in texts) == inverted


def test_without_a_bend_or_a_model_nothing_is_said(tmp_path: Path) -> None:
    assert sentences([]) == sentences(examples.groups(tmp_path, metrics("straight", None))) == []


def test_models_without_a_result_are_named() -> None:
    (text,) = sentences([], ["net", "other"])
    assert text.startswith("No result here: net, other.")
