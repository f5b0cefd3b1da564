"""Stage report: all files from what is there, the same bytes each time."""

import json
from pathlib import Path

import pytest

from pipeline.base import store
from pipeline.scores.pixels import Scores
from stages import report
from tests.pipeline.report import examples


def run(folder: Path, *models: str) -> str:
    settings = "{bootstrap_samples: 9, bootstrap_block_frames: 5, seed: 0}"
    entries = ", ".join(f"{model}: {{}}" for model in models)
    (folder / "params.yaml").write_text(f"models: {{{entries}}}\nevaluate: {settings}\n")
    assert report.main(folder, params=folder / "params.yaml") == folder / "report"
    return (folder / "report/table.md").read_text()


def test_all_files_are_written_and_repeat(tmp_path):
    assert run(tmp_path, "absent").startswith("No result here: absent.")
    assert (tmp_path / "report/figures").is_dir()
    examples.write_model(tmp_path, examples.metrics("sa-gnn-ncp"))
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
    metrics = json.loads(made[0]["metrics.json"])
    assert next(iter(metrics)) == "path-0/at 5 m/scene"
    error_m = metrics["path-0/at 5 m/scene"]["error"]
    sentence = f"Network `scene` has an error (displacement at 5 m) of {error_m:.2f} m on 2 drives"
    assert sentence in " ".join(text.split())
    assert metrics["angle-0/sa-gnn-ncp"]["nmse"] == pytest.approx(0.2)
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
