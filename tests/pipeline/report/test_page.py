"""The page: sections, plots, no request to other files, and no script from a drive's name."""

import html
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base import store
from pipeline.report import figures, tables
from pipeline.report.page import write_page
from pipeline.report.results import load_results
from tests.pipeline.report import examples

EVIL = "x</script><script>alert(1)</script>"
SECTIONS = [
    "Results", "Steering on the test drives", "Steering on the test drives, 10 frames ahead", "Figures of the paper",
    "Graphs in 3D", "Learning curves", "Models in detail",
]  # fmt: skip


@pytest.fixture
def data(tmp_path: Path) -> Path:
    examples.write_model(tmp_path, examples.metrics("net"))
    examples.write_model(tmp_path, examples.metrics("ahead", nmse=0.4, horizon=10), examples.predictions(0.1, False))
    for model in ("net", "ahead"):
        (tmp_path / f"train/{model}").mkdir(parents=True)
        (tmp_path / f"train/{model}/curve.csv").write_text("epoch,train_loss,val_nmse\n1,0.9,0.8\n2,0.5,\n")
    rng = np.random.default_rng(0)
    graph = {
        "frame": 9, "points": 60, "xyz_m": rng.uniform(-9, 9, (60, 3)).round(3).tolist(),
        "cls": [0] * 30 + [2] * 29 + [255], "edges": [[0, 1], [1, 2], [30, 31]],
    }  # fmt: skip
    store.write_json(tmp_path / "evaluate/net/structure.json", dict.fromkeys(examples.DRIVES, graph))
    for name in ("figures/paths", "figures/chain"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / f"{name}.png"), rng.integers(0, 255, (60, 2000, 3), np.uint8))
    return tmp_path


def write(data: Path, story: list[str] | None = None) -> str:
    results = load_results(data / "evaluate", ["net", "ahead"])
    captions = {"chain": "Figure 1.", "paths": "Figure 5."}
    write_page(data / "index.html", story or [], results, tables.steering_tables(results), [], [], captions, data)
    return (data / "index.html").read_text(encoding="utf-8")


def headings(text: str) -> list[str]:
    return [html.unescape(title) for title in re.findall(r"<h2>(.*?)</h2>", text)]


def test_the_page_is_complete_self_contained_and_repeats(data: Path) -> None:
    text = write(data, ["A sentence <b>."])
    assert text == write(data, ["A sentence <b>."])
    assert headings(text) == SECTIONS
    assert re.findall(r'<a href="#(.*?)">', text) == re.findall(r'<section id="(.*?)">', text)
    own = re.sub(r"<script>.*?</script>", "", text, count=1, flags=re.DOTALL)  # without plotly
    assert not re.findall(r'(?:src|href)="(?!#|data:)', own)
    assert "A sentence &lt;b&gt;." in own
    assert own.index("A sentence") < own.index("Figure 1.") < own.index("<h2>Results")
    captions = re.findall(r"<figcaption>(.*?)</figcaption>\s*<div class=\"plot\">", own)
    assert captions[:2] == [f"{drive}: steering over time" for drive in examples.DRIVES]


def test_a_structure_without_neighbours_in_the_metrics_is_left_out(data: Path) -> None:
    content = examples.metrics("net") | {"variant": {}}
    store.write_json(data / "evaluate/net/metrics.json", content)
    assert "Graphs in 3D" not in headings(write(data))
    results = load_results(data / "evaluate", ["net", "ahead"])
    assert "pruning" not in figures.draw(data / "figures", results, [], data)


def test_without_classes_nothing_is_called_pruned(data: Path) -> None:
    assert "edges after pruning" in write(data)
    path = data / "evaluate/net/structure.json"
    void = {drive: graph | {"cls": [255] * 60} for drive, graph in json.loads(path.read_text()).items()}
    store.write_json(path, void)
    text = write(data)
    assert "edges after pruning" not in text
    assert "semantic pruning" not in text


def test_a_name_with_a_script_is_text(data: Path) -> None:
    for model in ("net", "ahead"):
        table = examples.predictions(0.01).replace({"drive": {examples.DRIVES[0]: EVIL}})
        table.to_csv(data / f"evaluate/{model}/predictions.csv", index=False)
    graphs = json.loads((data / "evaluate/net/structure.json").read_text())
    store.write_json(data / "evaluate/net/structure.json", {EVIL: graphs[examples.DRIVES[0]]})
    text = write(data)
    assert "alert(1)" in text
    assert "<script>alert" not in text
    for plot in re.findall(r'<script type="application/json">(.*?)</script>', text, re.DOTALL):
        assert "<" not in plot
        json.loads(plot)


def test_uncertainty_has_a_table_and_a_band(data: Path) -> None:
    scores = {"nll": -1.5, "nll_constant": -1.2, "coverage_68": 0.66, "coverage_95": 0.93, "mae_deg_certain": 1.25}
    content = examples.metrics("net")
    content["test"]["uncertainty"] = scores
    assert "net ± σ" not in write(data)
    examples.write_model(data, content, examples.predictions(0.01).assign(sigma_rad=0.02))
    results = load_results(data / "evaluate", ["net", "ahead"])
    (table,) = (table for table in tables.steering_tables(results) if table.title == "Uncertainty")
    assert table.cells.to_numpy().tolist() == [["net", "-1.500", "-1.200", "66.0%", "93.0%", "1.25", "1.79"]]
    assert "net ± σ" in write(data)
