"""The three sentences follow from the numbers."""

from pathlib import Path

import pytest

from pipeline.report.results import load_results
from pipeline.report.story import sentences
from tests.pipeline.report import examples


def test_a_model_behind_odometry(tmp_path: Path) -> None:
    weak, best = (examples.metrics(name, nmse, {"odometry": 0.02}) for name, nmse in (("weak", 0.9), ("best", 0.2)))
    accuracy, weakness, step = sentences(examples.results(tmp_path, weak, best))
    assert accuracy.startswith("best, the best of 2 models, ")
    assert "20 % of the error of always predicting zero" in accuracy
    assert "10 times the error of odometry, which needs no learning" in accuracy
    assert weakness.startswith("It fails in sharp bends (|curvature| 0.03 to 0.1 1/m): RMSE 5.1°")
    assert "17.2°" in weakness
    assert "is steady: RMSE 2.6°" in weakness
    assert "motion: visual" in step


@pytest.mark.parametrize("nmse", [None, 0.2])
def test_missing_numbers_are_left_out(tmp_path: Path, nmse: float | None) -> None:
    content = examples.metrics("net")
    content["test"]["nmse"] = nmse
    text = sentences(examples.results(tmp_path, content))
    assert len(text) == (0 if nmse is None else 3)
    assert nmse is None or "no odometry" in text[0]
    assert sentences(load_results(tmp_path, [])) == []
