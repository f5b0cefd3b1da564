import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.perception.scores import Scores
from stages import report
from tests.pipeline.report.tables.results import result


def run(folder: Path, *models: str) -> str:
    settings = (
        "evaluate: {bootstrap_samples: 9, bootstrap_block_frames: 5, curvature_bins_1pm: [0.1], path: bicycle, seed: 0}"
    )
    content = f"models: {{{', '.join(f'{model}: {{}}' for model in models)}}}\n{settings}\n"
    (folder / "params.yaml").write_text(content)
    out = report.main(folder, folder / "report", folder / "params.yaml")
    assert out == folder / "report"
    return (out / "table.md").read_text()


def evaluate(folder: Path, model: str) -> None:
    store.write_json(folder / f"evaluate/{model}/metrics.json", result(model))
    columns = "drive,frame,time_s,speed_mps,steering_rad,predicted_rad,valid,onset"
    (folder / f"evaluate/{model}/predictions.csv").write_text(f"{columns}\na,0,0.0,8.0,0.1,0.2,1,0\n")


def test_what_depth_is_worth_stands_below_the_models_where_it_is_known(tmp_path: Path) -> None:
    without = run(tmp_path, "lonely")
    scores = {split: Scores() for split in ("train", "val", "test")}
    truth = np.full((40, 50), 10.0)
    scores["test"].add_depth("depth_dense", truth, truth)
    scores["test"].add_depth("ground_plane_dense", 2 * truth, truth)
    store.write_json(tmp_path / "scores/metrics.json", {split: score.report() for split, score in scores.items()})
    assert "train@lonely" in without
    assert "flat ground" not in without
    assert run(tmp_path, "lonely").startswith(without + "\n| depth of | truth |")
    assert "encoder.abs_rel_dense" in json.loads((tmp_path / "report/metrics.json").read_text())


def test_what_motion_is_worth_stands_below_that(tmp_path: Path) -> None:
    scores = {split: Scores().report() for split in ("train", "val", "test")}
    card = {"drives": 1, "frames": 9, "valid": 1.0, "judged": 8, "speed_ratio": 1.0, "nmse": 0.01}
    card |= {"yaw_rmse_degps": 0.2, "yaw_median_degps": 0.1}
    motion = {"visual": {"train": None, "val": None, "test": card}}
    store.write_json(tmp_path / "scores/metrics.json", {**scores, "motion": motion})
    assert "| visual | test | 1 | 9 | 100.0% | 8 |" in run(tmp_path, "lonely")
    assert json.loads((tmp_path / "report/metrics.json").read_text())["motion.visual.nmse"] == 0.01


def test_figures_and_curves_lie_beside_the_table(tmp_path: Path) -> None:
    evaluate(tmp_path, "net")
    text = run(tmp_path, "net", "absent")
    assert "| net | semantic |" in text
    assert "train@absent" in text
    assert json.loads((tmp_path / "report/metrics.json").read_text())["net.nmse"] == 0.2
    assert (tmp_path / "report/table.csv").read_text().splitlines()[1].startswith("net,semantic,gnn,ncp,ltc,")
    assert [path.name for path in (tmp_path / "report/steering").iterdir()] == ["net.csv"]
    assert list((tmp_path / "report/learning").iterdir()) == []  # trained elsewhere, and still an out
    assert list((tmp_path / "report/settings").iterdir()) == []  # no study


@pytest.mark.slow
def test_models_of_a_study_have_a_figure_and_a_table(tmp_path: Path) -> None:
    for model in ("sa-gnn-ncp", "points-125", "lambda-0"):
        evaluate(tmp_path, model)
    run(tmp_path, "sa-gnn-ncp", "points-125", "lambda-0")
    made = sorted(path.name for path in (tmp_path / "report/settings").iterdir())
    assert made == ["lambda.png", "points.png", "studies.csv", "studies.md"]
    text = (tmp_path / "report/settings/studies.md").read_text()
    assert text.startswith("## points\n\n| points a frame |")
    assert "- semantics: λ = 1 against 0: no difference shown." in text
    rows = (tmp_path / "report/settings/studies.csv").read_text().splitlines()
    assert [row.split(",")[:3] for row in rows[1:3]] == [
        ["points", "125", "points-125"],
        ["points", "1000", "sa-gnn-ncp"],
    ]


def test_the_same_again_is_the_same_bytes(tmp_path: Path) -> None:
    def made() -> dict[str, bytes]:
        run(tmp_path, "net")
        return {path.name: path.read_bytes() for path in (tmp_path / "report").rglob("*") if path.is_file()}

    evaluate(tmp_path, "net")
    assert made() == made()


def test_damaged_scores_are_one_error(tmp_path: Path) -> None:
    (tmp_path / "scores").mkdir()
    (tmp_path / "scores/metrics.json").write_text("{")
    with pytest.raises(InputError, match="dvc repro --force --single-item scores"):
        run(tmp_path, "lonely")
