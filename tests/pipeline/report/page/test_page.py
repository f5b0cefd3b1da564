"""The page that people open: what stands on it, that it needs nothing else, and that a browser shows it whole."""

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
from pipeline.report import predicted
from pipeline.report.figures import figures
from pipeline.report.page import plots, structure
from pipeline.report.page.page import write_page
from pipeline.report.sources import Sources
from pipeline.report.tables import comparison
from tests.pipeline.report.tables.results import result

DRIVES = ("2026_01_03_drive_0002", "2026_01_03_drive_0003")
SECTIONS = [
    "Results", "Predicted steering", "Predicted steering, 10 frames ahead", "The paper's figures",
    "The cloud and its graph", "Learning curves", "Plausibility of the labels", "Depth, classes and motion",
    "What the models were given", "All figures",
]  # fmt: skip


def write_model(folder: Path, name: str, error_rad: float) -> None:
    rows = ["drive,frame,time_s,speed_mps,steering_rad,predicted_rad,valid,onset"]
    for drive in DRIVES:
        for number in range(30):
            driven, valid = 0.01 * number, int(number != 20)
            said = "" if number < 7 else f"{driven + error_rad:.6f}"
            known = f"{drive},{number},{100 + number / 10:.6f},{number / 2:.4f},{driven:.9f}"
            rows.append(f"{known},{said},{valid},{int(number == 15)}")
    (folder / "evaluate" / name).mkdir(parents=True)
    (folder / "evaluate" / name / "predictions.csv").write_text("\n".join(rows))
    (folder / "train" / name).mkdir(parents=True)
    curve = "epoch,learning_rate,train_loss,val_mse_rad2,val_nmse\n1,0.1,0.9,0.01,0.8\n2,0.1,0.5,0.01,\n"
    (folder / "train" / name / "curve.csv").write_text(curve)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, error_rad in (("net", 0.01), ("ahead", 0.1)):
        write_model(tmp_path, name, error_rad)
    rng = np.random.default_rng(0)
    cloud = {
        "frame": 9, "points": 60, "xyz_m": rng.uniform(-9, 9, (60, 3)).round(3).tolist(),
        "cls": ([0] * 30 + [2] * 29 + [255]), "edges": [[0, 1], [1, 2], [30, 31]],
    }  # fmt: skip
    store.write_json(tmp_path / "evaluate/net/structure.json", dict.fromkeys(DRIVES, cloud))
    summary = {"frames": 60, "valid_share": None, "mean_abs_steering_rad": None, "max_abs_steering_rad": None}
    summary |= {"zero_mse_rad2": None, "dt_max_s": 0.31, "reversing_frames": 4, "sideways_frames": 0}
    store.write_json(tmp_path / "labels/summary.json", {DRIVES[0]: summary})
    (tmp_path / "pictures").mkdir()
    cv2.imwrite(str(tmp_path / f"pictures/{DRIVES[1]}.png"), rng.integers(0, 255, (60, 2000, 3), np.uint8))
    return tmp_path


def write(folder: Path) -> str:
    results = comparison.in_order([result("ahead", nmse=0.4, horizon=10), result("net")])
    sources = Sources(folder)
    tables = "| steering | <b> |\n| --- | --- |\n", "perceived"
    drawn = figures.draw(folder / "figures", results, sources)
    write_page(folder / "index.html", results, *tables, drawn, sources)
    return (folder / "index.html").read_text(encoding="utf-8")


def headings(text: str) -> list[str]:
    return [html.unescape(title) for title in re.findall(r"<h2>(.*?)</h2>", text)]


def test_it_is_whole_and_the_same_each_time(folder: Path) -> None:
    text = write(folder)
    assert headings(text) == SECTIONS
    assert text == write(folder)
    anchors = re.findall(r'<a href="#(.*?)">', text)
    assert anchors == re.findall(r'<section id="(.*?)">', text)
    # Own words only: none of a link, picture, script or font of elsewhere.
    own = text.replace(re.search(r"<script>(.*?)</script>", text, re.DOTALL).group(0), "", 1)
    assert "<script>" in text
    assert not re.findall(r'(?:src|href)="(?!#|data:)', own)
    assert "<b>" not in own  # what a table says is text


def test_best_and_baselines_come_first(folder: Path) -> None:
    rows = re.findall(r"<tr>\n(.*?)</tr>", write(folder), re.DOTALL)
    names = [re.sub("<.*?>", "", row).split("\n")[0] for row in rows[1:9]]
    assert names == ["net", "zero", "train_mean", "persistence", "ahead", "zero", "train_mean", "persistence"]


def test_without_the_other_stages_it_has_less(folder: Path) -> None:
    for name in ("train", "labels", "pictures"):
        shutil.rmtree(folder / name)
    (folder / "evaluate/net/structure.json").unlink()
    missing = {SECTIONS[4], SECTIONS[5], SECTIONS[6], SECTIONS[8]}
    assert headings(write(folder)) == [title for title in SECTIONS if title not in missing]


def test_a_damaged_source_is_named(folder: Path) -> None:
    (folder / f"pictures/{DRIVES[1]}.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"drive_0003\.png is not a picture.*single-item pictures"):
        write(folder)
    (folder / "evaluate/net/predictions.csv").write_text("drive,frame\na,1\n")
    with pytest.raises(InputError, match=r"net/predictions\.csv: has no column .*single-item evaluate@net"):
        write(folder)


def test_figures_show_what_was_predicted(folder: Path) -> None:
    steering = predicted.read(folder / "evaluate/net")
    driven, model = plots.over_time({"net": steering[DRIVES[0]]}).data
    assert driven.x[:2].tolist() == pytest.approx([0.0, 0.1])
    assert np.isnan(driven.y[20])  # not valid, so not driven
    assert np.isnan(model.y[:7]).all()  # no whole window
    np.testing.assert_allclose((model.y - driven.y)[21:], np.rad2deg(0.01), atol=1e-4)
    bars = plots.by_speed({"net": list(steering.values())}).data[0]
    assert bars.y[0] is None  # slower than the first whole window
    np.testing.assert_allclose([value for value in bars.y if value is not None], np.rad2deg(0.01), atol=1e-4)


def test_edges_before_pruning_are_the_k_nearest(folder: Path) -> None:
    cloud = json.loads((folder / "evaluate/net/structure.json").read_text())[DRIVES[0]]
    xyz, cls = np.array(cloud["xyz_m"], np.float32), np.array(cloud["cls"], np.uint8)
    distance = np.linalg.norm(xyz[:, None] - xyz, axis=-1)
    near = distance.argsort(axis=1)[:, 1:4]
    expected = {(min(a, b), max(a, b)) for a in range(60) for b in near[a].tolist()}
    assert set(map(tuple, structure.edges(xyz, cls, 3).tolist())) == expected
    before, after, *points = structure.draw(cloud, 3).data
    assert (before.name, after.name) == (f"{len(expected)} edges before pruning", "3 edges after pruning")
    assert [trace.name for trace in points] == ["road", "building", "void"]
    assert sum(len(trace.x) for trace in points) == 60
    line = np.stack([after.x, after.y, after.z], axis=1)[:2]
    np.testing.assert_allclose(line, [[x, z, -y] for x, y, z in cloud["xyz_m"][:2]], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])  # a screen and a phone
def test_a_browser_shows_it_whole(folder: Path, width: int) -> None:
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if not browser:
        pytest.skip("no browser: apt-get install chromium")
    write(folder)
    expected = 2 * (len(DRIVES) + 3) + 1 + len(DRIVES)
    # A frame of that width; a headless window has a least width. The script says what the browser made of the page, as
    # soon as every plot is drawn: on a busy machine that takes long.
    (folder / "frame.html").write_text(f"""
    <iframe id="page" src="index.html" width="{width}" height="800"></iframe>
    <script>
    const started = performance.now();
    const timer = setInterval(() => {{
      const page = document.getElementById("page").contentDocument, root = page.documentElement;
      const plots = [...page.querySelectorAll(".js-plotly-plot")];
      const drawn = plots.filter(plot => plot.querySelector(".main-svg"));
      if (drawn.length < {expected} && performance.now() - started < 80000) return;
      clearInterval(timer);
      document.body.innerText = JSON.stringify({{
        wide: root.scrollWidth, inner: root.clientWidth, plots: plots.length, drawn: drawn.length,
        widest: Math.max(...drawn.map(plot => plot.querySelector(".main-svg").getBoundingClientRect().width)),
      }});
    }}, 1000);</script>""")
    done = subprocess.run(
        [browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--dump-dom",
         "--allow-file-access-from-files", "--virtual-time-budget=90000", f"--user-data-dir={folder / 'profile'}",
         (folder / "frame.html").as_uri()],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    said = re.search(r"\{.*\}", html.unescape(done.stdout))
    assert said, done.stderr[-2000:]
    seen = json.loads(said.group(0))
    assert seen["plots"] == seen["drawn"] == expected
    assert seen["wide"] <= seen["inner"] <= width  # nothing sticks out
    assert seen["widest"] <= width
