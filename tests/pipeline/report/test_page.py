"""The page: complete, self-contained, and safe for names of any kind."""

import html
import re

import cv2
import numpy as np
import pandas as pd

from pipeline.report import drawings, page
from pipeline.report.drawings import Picture
from pipeline.report.tables import Section
from tests.pipeline.report import examples
from tests.pipeline.report.examples import metrics

EVIL = "x</script><script>alert(1)</script>"


def test_the_page_is_complete_self_contained_and_runs_no_script_of_a_name(tmp_path, monkeypatch):
    run = {
        "preset": "mine",
        "revision": "abc1234",
        "started_s": 0,
        "settings": {"train": {"epochs": 3}},
    }
    monkeypatch.setattr(page, "read_run", lambda: run)
    cv2.imwrite(str(tmp_path / "bend.jpg"), np.full((60, 200, 3), 90, np.uint8))
    table = pd.DataFrame({"nmse": ["0.50\n0.40 to 0.60"]}, pd.Index([f"`{EVIL}` ✓"], name="model"))
    content = page.Page(
        sentences=["Network `net` against *zero*.", "Verdict: better.", "A sentence <b>."],
        doubts=["a clock is late"],
        picture=Picture(tmp_path / "bend.jpg", "The path."),
        results=[Section("Results", table, "A note.")],
        details={"Folded": ["A paragraph."], "Nothing": [None]},
    )
    page.write(tmp_path / "index.html", content)

    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert re.findall("<summary>(.*?)</summary>", text) == [
        "Folded",
        "Settings of the preset",
    ]
    assert not re.findall(r'(?:src|href)="(?!#|data:)', text)
    order = [
        "<code>net</code> against <em>zero</em>.",
        "Verdict: better.",
        "data:image/jpeg;base64,",
    ]
    order += [
        "The path.",
        "doubt: a clock is late",
        "A sentence &lt;b&gt;.",
        "A note.",
        "A paragraph.",
    ]
    places = [text.index(part) for part in order]
    assert places == sorted(places)
    assert "0.50<br><small>0.40 to 0.60</small>" in text
    assert "<pre>train:\n  epochs: 3\n</pre>" in text
    assert "Next: edit presets/mine.yaml, and run make mine" in text
    assert re.search(r"Origin: revision .* min</p>", text)
    assert html.escape(EVIL) in text
    assert "<script" not in text


def test_a_network_without_validation_has_its_training_loss(tmp_path, monkeypatch):
    drawn = list[tuple[str, list[float]]]()

    def plot(_: object, x: pd.Series, y: pd.Series, style: str, **options: object) -> None:
        drawn.append((style, y.tolist()))

    monkeypatch.setattr("matplotlib.axes.Axes.plot", plot)
    monkeypatch.setattr(drawings, "_title", lambda *_: None)
    values = examples.compare(tmp_path, metrics("net"))
    for folder, errors in (("", ["0.6", "0.5"]), ("seed-1/", ["", ""])):
        curve = tmp_path / f"train/net/{folder}curve.csv"
        curve.parent.mkdir(parents=True)
        rows = [f"{epoch},0.{9 - epoch},{error}" for epoch, error in enumerate(errors, start=1)]
        curve.write_text("\n".join(["epoch,train_loss,val_nmse", *rows]))
    picture = drawings.draw_learning(tmp_path, values, tmp_path / "train")
    assert picture.path.is_file()
    assert drawn == [("-", [0.6, 0.5]), (":", [0.8, 0.7])]
    assert drawings.draw_learning(tmp_path, values, tmp_path / "absent") is None
