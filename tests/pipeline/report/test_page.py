"""The page: sections, plots, no request to other files, and no script from a drive's name."""

import html
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline.report import plots, tables
from pipeline.report.page import write_page
from pipeline.report.results import load_groups
from tests.pipeline.report import examples
from tests.pipeline.report.examples import metrics
from tests.pipeline.report.test_tables import SETTINGS

EVIL = "x</script><script>alert(1)</script>"
MODELS = ("net", "ahead", "path")
SECTIONS = [
    "Results", "Test drives: steering angle", "Test drives: steering angle, 10 frames ahead",
    "Test drives: path ahead", "Largest errors", "Learning curves", "Models in detail",
]  # fmt: skip


@pytest.fixture
def data(tmp_path: Path) -> Path:
    for content in (metrics("net"), metrics("ahead", horizon=10), metrics("path", predict="path")):
        examples.write_model(tmp_path, content)
        (tmp_path / f"train/{content['model']}").mkdir(parents=True)
        (tmp_path / f"train/{content['model']}/curve.csv").write_text("epoch,train_loss,val_nmse\n1,0.9,0.8\n2,0.5,\n")
    (tmp_path / "figures").mkdir()
    for name in ("errors-angle-0", "chain"):
        cv2.imwrite(str(tmp_path / f"figures/{name}.png"), np.full((60, 200, 3), 90, np.uint8))
    return tmp_path


def write(data: Path) -> str:
    groups = load_groups(data / "evaluate", MODELS)
    captions = {"chain": "Figure 1.", "errors-angle-0": "Errors."}
    built = tables.steering_tables(groups, SETTINGS)
    write_page(data / "index.html", ["A sentence <b>."], groups, built, [], captions, data)
    return (data / "index.html").read_text(encoding="utf-8")


def test_the_page_is_complete_self_contained_and_repeats(data: Path) -> None:
    text = write(data)
    assert text == write(data)
    assert [html.unescape(title) for title in re.findall(r"<h2>(.*?)</h2>", text)] == SECTIONS
    assert re.findall(r'<a href="#(.*?)">', text) == re.findall(r'<section id="(.*?)">', text)
    own = re.sub(r"<script>.*?</script>", "", text, count=1, flags=re.DOTALL)  # without plotly
    assert not re.findall(r'(?:src|href)="(?!#|data:)', own)
    assert own.index("A sentence &lt;b&gt;.") < own.index("Figure 1.") < own.index("<h2>Results")
    captions = re.findall(r"<figcaption>(.*?)</figcaption>\s*<div class=\"plot\">", own)
    assert captions[:2] == [f"{drive}: steering angle over time" for drive in examples.DRIVES]


def test_a_name_with_a_script_is_text(data: Path) -> None:
    for model in MODELS:
        path = data / f"evaluate/{model}/predictions.csv"
        path.write_text(path.read_text().replace(examples.DRIVES[0], EVIL))
    text = write(data)
    assert "alert(1)" in text
    assert "<script>alert(1)" not in text


def traces(plot: plots.Plot) -> dict[str, Any]:
    return {trace["name"]: trace for trace in plot["data"]}


def test_odometry_has_a_gap_where_it_is_not_measured(tmp_path: Path) -> None:
    (group,) = examples.groups(tmp_path, metrics("net"))
    drive = group.predictions[group.predictions["drive"] == examples.DRIVES[0]]
    lines = traces(plots.over_time(drive, plots.styles([group])))
    assert lines["odometry"]["y"][:2] == [None, round(np.rad2deg(0.011), 4)]
    assert lines["net"]["y"][:8] == [None] * 7 + [round(np.rad2deg(0.08), 4)]
    assert lines["driven"]["y"][20] is None


def test_the_legend_shows_the_references_and_the_best_models(tmp_path: Path) -> None:
    """Whatever their order: the paper's networks come first, and are not the best."""
    worse = [metrics(f"cnn-{number}", 0.5 + number, input="image", spatial="cnn", window=16) for number in range(3)]
    groups = examples.groups(tmp_path, *worse, metrics("a", 0.3), metrics("b", 0.1), metrics("c", 0.2))
    look = plots.styles(groups)
    shown = {name for name, style in look.items() if style["visible"] is True}
    assert shown == {"a", "b", "c", "driven", "odometry", "zero"}
    bars = plots.by_curvature(groups[0].models, "steering_rad", look)["data"]
    assert [(bar["name"], bar["x"], bar["y"]) for bar in bars][-1] == (
        "zero", ["0 to 0.03"], [round(np.rad2deg(0.1), 4)]
    )  # fmt: skip
