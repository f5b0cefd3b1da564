"""The page: complete, self-contained, and safe for names of any kind."""

import html
import re

import cv2
import numpy as np
import pandas as pd

from pipeline.report import page
from pipeline.report.drawings import Picture
from pipeline.report.section import Section

EVIL = "x</script><script>alert(1)</script>"


def test_the_page_is_complete_self_contained_and_runs_no_script_of_a_name(tmp_path):
    cv2.imwrite(str(tmp_path / "bend.jpg"), np.full((60, 200, 3), 90, np.uint8))
    table = pd.DataFrame({"nmse": ["0.50\n0.40 to 0.60"]}, pd.Index([f"`{EVIL}` ✓"], name="model"))
    content = page.Page(
        sentences=["Network `net` against *zero*.", "Verdict: better.", "A sentence <b>."],
        doubts=["a clock is late"],
        picture=Picture(tmp_path / "bend.jpg", "The path."),
        results=[Section("Results", table, "A note.")],
        details={"Folded": ["A paragraph."], "Nothing": [None]},
        origin={"preset": "mine", "revision": "abc1234"},
        settings={"train": {"epochs": 3}},
    )
    page.write_page(tmp_path / "index.html", content)

    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    parts = ["<code>net</code> against <em>zero</em>.", "data:image/jpeg;base64,", "The path."]
    parts += ["doubt: a clock is late", "A sentence &lt;b&gt;.", html.escape(EVIL)]
    parts += ["Origin: preset mine, revision abc1234"]
    parts += ["0.50<br><small>0.40 to 0.60</small>", "A note.", "A paragraph."]
    parts += ["<pre>train:\n  epochs: 3\n</pre>", "edit presets/mine.yaml, and run make mine"]
    assert [part for part in parts if part not in text] == []
    assert re.findall("<summary>(.*?)</summary>", text) == ["Folded", "Settings of the preset"]
    assert not re.findall(r'(?:src|href)="(?!#|data:)', text)
    assert "<script" not in text
