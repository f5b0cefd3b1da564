"""The page and its plots."""

import base64
import html
import re

import cv2
import numpy as np
import pandas as pd

from pipeline.camera.classes import ROAD, VOID
from pipeline.report import page, plots, tables
from pipeline.report.street_view import View
from tests.pipeline.report import examples
from tests.pipeline.report.examples import metrics

DRIVE = examples.DRIVES[0]
EVIL = "x</script><script>alert(1)</script>"


def test_the_page_is_complete_self_contained_and_runs_no_script_of_a_name(tmp_path, monkeypatch):
    run = {
        "preset": "mine",
        "revision": "abc1234",
        "started_s": 0,
        "settings": {"train": {"epochs": 3}},
        "next": "make mine && make test",
    }
    monkeypatch.setattr(page, "read_run", lambda: run)
    groups = examples.groups(
        tmp_path,
        metrics("sa-gnn-ncp"),
        metrics("ahead", horizon=10),
        metrics("path", predict="path"),
    )
    groups[0].first_seeds["drive"] = groups[0].first_seeds["drive"].replace(DRIVE, EVIL)
    comparisons = examples.comparisons(groups)
    cv2.imwrite(str(tmp_path / "chain.png"), np.full((60, 200, 3), 90, np.uint8))
    curve = tmp_path / "train/sa-gnn-ncp/curve.csv"
    curve.parent.mkdir(parents=True)
    curve.write_text("epoch,learning_rate,train_loss,val_nmse\n1,0.1,0.7,\n")

    content: dict[str, page.Content] = {
        "Errors": page.errors(comparisons),
        "From image to graph": [page.picture(tmp_path / "chain.png", "Figure 1.")],
        "Nothing": [],
    }
    for group, comparison in zip(groups, comparisons, strict=True):
        content[f"Test drives: {comparison.title}"] = page.test_drives(
            tmp_path, group, comparison, tmp_path / "ingest"
        )
        table = tables.results_table(comparison)
        content[table.title] = [table]
    content["Learning curves"] = page.learning(tmp_path / "train", ["sa-gnn-ncp"])
    sentences = ["Found.", "A sentence <b>."]
    page.write(tmp_path / "index.html", page.Page(sentences, None, ["a clock is late"], content))

    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    headings = [html.unescape(title) for title in re.findall(r"<h2>(.*?)</h2>", text)]
    assert headings == [title for title in content if title != "Nothing"]
    assert re.findall(r'<a href="#(.*?)">', text) == re.findall(r'<section id="(.*?)">', text)
    own = re.sub(r"<script>.*?</script>", "", text, count=1, flags=re.DOTALL)  # without plotly
    assert not re.findall(r'(?:src|href)="(?!#|data:)', own)
    order = ["Found.", "Doubt: a clock is late", "A sentence &lt;b&gt;.", "<h2>Errors", "Figure 1."]
    places = [own.index(part) for part in order]
    assert places == sorted(places)
    assert "<pre>train:\n  epochs: 3\n</pre>" in own
    assert "Next: make mine &amp;&amp; make test" in own
    assert re.search(r"Made at revision .* min</p>", own)
    names = re.findall(r'Plotly\.newPlot\(\s*"(.*?)"', own)
    # Learning curves; errors and two drives of each group.
    assert len({*names}) == len(names) == 1 + 3 * len(groups)
    assert "alert(1)" in own
    assert "<script>alert(1)" not in own


def test_points_have_a_trace_per_class_and_edges_one_in_each_frame():
    xyz = np.array([[1.0, 2, 3], [4, 3, 6], [7, 1, 9], [7, 1, 51]])  # the last is outside
    edges = np.array([[1, 2], [2, 3]])
    views = [View(7, xyz=xyz, points_cls=np.array([ROAD, ROAD, VOID, VOID]), edges=edges)]
    views += [View(9, xyz=xyz[:1], points_cls=np.array([ROAD]), edges=edges[:0])]
    figure = plots.in_space(views)
    assert [step.label for step in figure.layout.sliders[0].steps] == [
        frame.name for frame in figure.frames
    ]
    road, void, line = figure.data
    assert (road.name, road.marker.color, void.name) == ("road", "rgb(128, 64, 128)", "no class")
    assert {*zip(road.x, road.y, road.z, strict=True)} == {(1, 3, -2), (4, 6, -3)}
    np.testing.assert_array_equal(
        [line.x, line.y, line.z], [[4, 7, np.nan], [6, 9, np.nan], [-3, -1, np.nan]]
    )
    first, second = figure.frames
    assert [len(trace.x) for trace in first.data] == [2, 1, 3]
    assert [len(trace.x) for trace in second.data] == [1, 0, 0]
    length_m = np.array([44, 50, 14])  # of the axes
    ratio = figure.layout.scene.aspectratio
    assert np.ptp([ratio.x, ratio.y, ratio.z] / length_m) < 1e-9


def test_the_image_and_the_title_follow_the_slider():
    point = np.array([[1.0, 0, 3]])
    rgb = np.full((8, 16, 3), [250, 0, 0], np.uint8)
    views = [View(7, rgb, xyz=point, points_cls=np.array([ROAD]))]
    views += [View(9, xyz=point - 9, points_cls=np.array([ROAD]))]
    figure = plots.in_space(views, "a drive")
    for frame, is_visible, count in zip(figure.frames, [True, False], [1, 0], strict=True):
        title = frame.layout.title
        assert title.text == "a drive"
        assert title.subtitle.text.startswith(f"frame {frame.name}, ")
        assert title.subtitle.text.endswith(f": {count} of 1 points")
        assert frame.data[-1].visible == is_visible
    jpeg = base64.b64decode(figure.data[-1].source.partition(",")[2])
    shown = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR_RGB)
    assert np.abs(shown.astype(int) - rgb).max() < 8


def test_a_network_without_validation_has_its_training_loss():
    columns = {"epoch": [1, 2], "train_loss": [0.7, 0.5], "val_nmse": [0.6, np.nan]}
    validated = pd.DataFrame(columns)
    without = pd.DataFrame(columns | {"val_nmse": np.nan})
    first, second = plots.learning({"net": validated, "net.seed-1": without}).data
    np.testing.assert_allclose(first.y, columns["val_nmse"], rtol=1e-6)
    np.testing.assert_allclose(second.y, columns["train_loss"], rtol=1e-6)
    assert first.legendgroup == "net"
    assert first.showlegend
    assert not second.showlegend
