"""The page: sections, plots, no request to other files, and no script from a drive's name."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.report import tables
from pipeline.report.page import plots
from pipeline.report.page.page import write_page
from pipeline.report.results import load_results
from tests.pipeline.report import examples

EVIL = "x</script><script>alert(1)</script>"
SECTIONS = [
    "Results", "Steering on the test drives", "Steering on the test drives, 10 frames ahead", "Figures of the paper",
    "Graphs in 3D", "Learning curves", "Models in detail", "Input of the test drives",
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
    for name in (f"pictures/{examples.DRIVES[1]}", "figures/paths", "figures/chain"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / f"{name}.png"), rng.integers(0, 255, (60, 2000, 3), np.uint8))
    return tmp_path


def write(data: Path, story: list[str] | None = None) -> str:
    results = load_results(data / "evaluate", ["net", "ahead"])
    figures = {"chain": "Figure 1.", "paths": "Figure 5."}
    write_page(data / "index.html", story or [], results, tables.steering_tables(results), [], figures, data)
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


def test_stages_that_are_not_here_have_no_section(data: Path) -> None:
    for name in ("train", "pictures", "evaluate/net/structure.json"):
        shutil.rmtree(data / name) if (data / name).is_dir() else (data / name).unlink()
    missing = {"Graphs in 3D", "Learning curves", "Input of the test drives"}
    assert headings(write(data)) == [title for title in SECTIONS if title not in missing]


def test_a_damaged_picture_is_one_error(data: Path) -> None:
    path = data / f"pictures/{examples.DRIVES[1]}.png"
    path.write_bytes(b"no picture")
    with pytest.raises(InputError) as raised:
        write(data)
    assert (raised.value.where, raised.value.fix.split()[-1]) == (str(path), "pictures")


def test_plots_show_driven_odometry_and_predictions(data: Path) -> None:
    found = load_results(data / "evaluate", ["net", "ahead"])
    table = found.first_seed(["net"])
    figure = plots.over_time(table[table["drive"] == examples.DRIVES[0]])
    driven, odometry, model = figure.data
    assert [trace.name for trace in figure.data] == ["driven", "odometry", "net"]
    assert not figure.layout.xaxis.rangeslider.visible
    assert np.isnan(driven.y[20])  # invalid
    assert np.isnan(model.y[:7]).all()  # no complete window
    np.testing.assert_allclose((model.y - odometry.y)[7:], np.rad2deg(0.009), atol=1e-6)
    without = found.first_seed(["ahead"])
    assert [trace.name for trace in plots.over_time(without).data] == ["driven", "ahead"]
    long = table.assign(elapsed_s=table["elapsed_s"] * 10)
    assert plots.over_time(long).layout.xaxis.rangeslider.visible


def test_scatter_has_equal_axes_around_all_points(data: Path) -> None:
    figure = plots.scatter(load_results(data / "evaluate", ["net"]).predictions)
    assert figure.layout.xaxis.range == figure.layout.yaxis.range
    assert figure.layout.xaxis.range[1] == pytest.approx(1.05 * np.rad2deg(0.3))
    assert figure.layout.yaxis.scaleanchor == "x"


def test_bars_leave_out_empty_ranges(data: Path) -> None:
    found = load_results(data / "evaluate", ["net"])
    net, zero = plots.by_curvature(found.metrics).data
    assert (net.name, zero.name, len(net.x)) == ("net", "zero", 2)


def test_edges_before_pruning_are_the_nearest_neighbours(data: Path) -> None:
    graph = json.loads((data / "evaluate/net/structure.json").read_text())[examples.DRIVES[0]]
    xyz, cls = np.array(graph["xyz_m"], np.float32), np.array(graph["cls"], np.uint8)
    near = np.linalg.norm(xyz[:, None] - xyz, axis=-1).argsort(axis=1)[:, 1:4]
    expected = {(min(a, b), max(a, b)) for a in range(60) for b in near[a].tolist()}
    assert set(map(tuple, plots.unpruned_edges(xyz, cls, 3).tolist())) == expected
    *points, before, after = plots.graph_3d(graph, 3).data
    assert [trace.name for trace in points] == ["road", "building", "void"]
    assert (before.visible, after.visible) == ("legendonly", True)
    line = np.stack([after.x, after.y, after.z], axis=1)[:2]
    np.testing.assert_allclose(line, [[x, z, -y] for x, y, z in graph["xyz_m"][:2]], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])  # a screen and a phone
def test_a_browser_draws_all_plots_within_the_screen(data: Path, width: int) -> None:
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if not browser:
        pytest.skip("no browser: apt-get install chromium")
    text = write(data)
    expected = text.count('<div class="plot">')
    # The frame sets the width; a headless window has a minimum. It reports when every plot is drawn.
    (data / "frame.html").write_text(f"""
    <iframe id="page" src="index.html" width="{width}" height="800"></iframe>
    <script>
    const started = performance.now();
    const timer = setInterval(() => {{
      const page = document.getElementById("page").contentDocument, root = page.documentElement;
      const drawn = [...page.querySelectorAll(".js-plotly-plot")].filter(plot => plot.querySelector(".main-svg"));
      if (drawn.length < {expected} && performance.now() - started < 80000) return;
      clearInterval(timer);
      document.body.innerText = JSON.stringify({{
        wide: root.scrollWidth, inner: root.clientWidth, drawn: drawn.length,
        tables: [...page.querySelectorAll(".wide")].filter(table => table.scrollWidth > table.clientWidth).length,
        widest: Math.max(...drawn.map(plot => plot.querySelector(".main-svg").getBoundingClientRect().width)),
      }});
    }}, 1000);</script>""")
    done = subprocess.run(
        [browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--dump-dom",
         "--allow-file-access-from-files", "--virtual-time-budget=90000", f"--user-data-dir={data / 'profile'}",
         (data / "frame.html").as_uri()],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    found = re.search(r"\{.*\}", html.unescape(done.stdout))
    assert found, done.stderr[-2000:]
    page = json.loads(found.group(0))
    assert page["drawn"] == expected
    assert page["wide"] <= page["inner"] <= width
    assert page["widest"] <= width
    assert page["tables"] == 0 or width < 1000  # on a phone, tables scroll
