"""Stage report: all files from what is there, the same bytes each time."""

import json
import re
from pathlib import Path

import pytest
import yaml

from pipeline.base import store
from pipeline.base.checkout import ROOT
from pipeline.scores.pixels import Scores
from stages import report
from tests.pipeline.report import examples


def run(folder: Path, *models: str) -> str:
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    params["models"] = {model: {} for model in models}
    params["evaluate"] |= {"bootstrap_samples": 9, "bootstrap_block_s": 0.5}
    (folder / "params.yaml").write_text(yaml.safe_dump(params))
    assert report.main(folder, params=folder / "params.yaml") == folder / "report"
    return (folder / "report/table.md").read_text()


def test_a_machine_that_only_evaluated_gets_a_page(tmp_path):
    """Without the folders of other stages, there are no scores, no images and no curves."""
    examples.write_model(tmp_path, examples.metrics("mine"))
    text = run(tmp_path, "mine", "sa-gnn-ncp")
    assert "## Results: steering angle" in text
    assert "All streets are rendered." in text
    report_folder = tmp_path / "report"
    assert "No result here: sa-gnn-ncp." in (report_folder / "index.html").read_text()
    pictures = {path.name for path in (report_folder / "figures").iterdir()}
    assert pictures == {"errors-angle-0.png", "time-angle-0.png"}
    assert len((report_folder / "curves.csv").read_text().splitlines()) == 1


def test_all_files_are_written_and_repeat(tmp_path):
    assert run(tmp_path, "absent").startswith("No result here: absent.")
    assert (tmp_path / "report/figures").is_dir()
    content = examples.metrics("sa-gnn-ncp") | {"seeds": [0, 1]}
    examples.write_model(tmp_path, content)
    examples.write_model(tmp_path, examples.metrics("scene", predict="path"))
    for folder in ("", "seed-1/"):
        curve = tmp_path / f"train/sa-gnn-ncp/{folder}curve.csv"
        curve.parent.mkdir(parents=True)
        curve.write_text(
            "epoch,learning_rate,train_loss,val_nmse\n1,0.003,0.70,0.6\n2,0.001,0.5,\n"
        )
    recorded = {"speed": {"line": "doubt: speed of 3"}, "angle": {"line": "angle of 2"}}
    splits = {split: Scores().to_report() for split in ("train", "val", "test")}
    motion = dict.fromkeys(splits)
    scores = {**splits, "motion": motion, "recorded": recorded}
    store.write_json(tmp_path / "scores/metrics.json", scores)
    store.write_json(tmp_path / "encoder/config.json", {"sources": ["b0.pt: its URL (its terms)"]})
    made = []
    for _ in range(2):
        text = run(tmp_path, "sa-gnn-ncp", "scene", "absent")
        files = [path for path in (tmp_path / "report").rglob("*") if path.is_file()]
        made.append({path.name: path.read_bytes() for path in files})
    assert made[0] == made[1]
    assert "## Results: steering angle" in text
    assert "## nmse by range: path ahead" in text
    errors = json.loads(made[0]["error.json"])
    assert [*errors] == ["scene", "sa-gnn-ncp"]
    error_m = errors["scene"]
    sentence = f"the path ahead (at 5 m) is off by {error_m:.2f} m with `scene`"
    assert sentence in " ".join(text.split())
    assert errors["sa-gnn-ncp"] == pytest.approx(0.2)
    curves = "model,seed,epoch,learning_rate,train_loss,val_nmse\n"
    curves += "sa-gnn-ncp,0,1,0.003,0.70,0.6\nsa-gnn-ncp,0,2,0.001,0.5,\n"
    curves += "sa-gnn-ncp,1,1,0.003,0.70,0.6\nsa-gnn-ncp,1,2,0.001,0.5,\n"
    assert made[0]["curves.csv"].decode() == curves
    results = json.loads(made[0]["results.json"])
    assert results["scores"]["recorded"] == recorded
    assert results["frames"]["path-0"] == "frames that scene predicts"

    # This machine has neither images nor clouds.
    pictures = {name for name in made[0] if name.endswith((".png", ".jpg"))}
    charts = {"errors-path-0.png", "errors-angle-0.png", "time-path-0.png", "time-angle-0.png"}
    assert pictures == charts | {"learning.png"}
    page = made[0]["index.html"].decode()
    for part in ("No result here: absent.", "<p>doubt: speed of 3</p>", "angle of 2", "b0.pt: its"):
        assert part in page

    # Each definition is of a word that the page has elsewhere.
    body, definitions = page.split("<summary>Definitions</summary>")
    words = re.findall("<p>([^:]+):", definitions.partition("</details>")[0])
    shown = re.sub("<[^>]*>", " ", body.partition("<body>")[2])
    assert {"displacement", "nmse", "MAE", "edges"} <= {*words}
    assert not {"the paper's claims", "coverage", "level road"} & {*words}
    assert [word for word in words if word.lower() not in shown.lower()] == []
