"""Stage report: all files from what is there, the same bytes each time."""

import json
from pathlib import Path

import numpy as np

from pipeline.base import store
from pipeline.perception.scores import Scores
from stages import report
from tests.pipeline.report import examples


def run(folder: Path, *models: str) -> str:
    settings = "{bootstrap_samples: 9, bootstrap_block_frames: 5, curvature_bins_1pm: [0.1], path: bicycle, seed: 0}"
    entries = ", ".join(f"{model}: {{}}" for model in models)
    (folder / "params.yaml").write_text(f"models: {{{entries}}}\nevaluate: {settings}\n")
    assert report.main(folder, folder / "report", folder / "params.yaml") == folder / "report"
    return (folder / "report/table.md").read_text()


def test_all_files_are_written_and_repeat(tmp_path: Path) -> None:
    for model in ("sa-gnn-ncp", "other"):
        examples.write_model(tmp_path, examples.metrics(model))
    scores = {split: Scores() for split in ("train", "val", "test")}
    scores["test"].add_depth("depth_dense", np.full((40, 50), 10.0), np.full((40, 50), 10.0))
    store.write_json(tmp_path / "scores/metrics.json", {split: score.report() for split, score in scores.items()})
    made = []
    for _ in range(2):
        text = run(tmp_path, "sa-gnn-ncp", "other", "absent")
        files = [path for path in (tmp_path / "report").rglob("*") if path.is_file()]
        made.append({str(path.relative_to(tmp_path / "report")): path.read_bytes() for path in files})
    assert made[0] == made[1]
    assert {*made[0]} >= {
        "index.html", "table.md", "table.csv", "metrics.json", "figures/paths.png", "figures/paths.svg",
        "steering/sa-gnn-ncp.csv",
    }  # fmt: skip
    assert text.startswith("## Results\n\n| model ")
    assert text.index("train@absent") < text.index("## Depth")
    metrics = json.loads(made[0]["metrics.json"])
    assert (metrics["sa-gnn-ncp.nmse"], metrics["encoder.abs_rel_dense"]) == (0.2, 0.0)
    assert made[0]["table.csv"].decode().splitlines()[1].startswith("sa-gnn-ncp,semantic,gnn,ncp,ltc,")


def test_without_results_all_outputs_exist_and_temporary_figures_of_a_killed_run_are_removed(tmp_path: Path) -> None:
    for _ in range(2):
        assert "dvc repro --pull --downstream train@lonely" in run(tmp_path, "lonely")
        folders = {path.name for path in (tmp_path / "report").iterdir() if path.is_dir()}
        assert folders == {"learning", "steering", "figures"}
        assert json.loads((tmp_path / "report/metrics.json").read_text()) == {}
        left = tmp_path / "report/figures/.paths.svg.abcd1234.tmp"
        assert not left.exists()
        left.mkdir()
        (left / "paths.svg").write_text("half")
