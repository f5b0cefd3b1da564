"""Metrics and predictions of all models: order of the rows, baselines, networks of the paper."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.report import paper
from pipeline.report.results import load_results, load_structures
from tests.pipeline.report import examples

PAPERS = {"input": "depth", "semantics": 0.0}  # do-gnn-ncp of the paper


def test_rows_are_sorted_by_horizon_then_as_in_the_paper_with_baselines_last(tmp_path: Path) -> None:
    found = examples.results(
        tmp_path,
        examples.metrics("far", odometry={"odometry": 0.5}, horizon=10),
        examples.metrics("ours", spatial="gatv2", odometry={"odometry": 0.04, "odometry_lidar": None}),
        examples.metrics("do", **PAPERS),
        examples.metrics("lstm", input="lidar-50k", temporal="lstm", semantics=0.0),
    ).metrics
    baselines = ["zero", "train_mean", "persistence", "odometry"]
    names = ["lstm", "do", "ours", *baselines, "odometry_lidar", "far", *baselines]
    assert [*found["model"]] == names
    assert [*found["baseline"]] == [name in (*baselines, "odometry_lidar") for name in names]
    rows = found[found["line.horizon"] == 0].set_index("model")
    assert rows.loc["odometry", ["test.nmse", "train.nmse"]].tolist() == [0.04, 0.04]
    assert rows.loc["odometry", f"test.by_drive.{examples.DRIVES[0]}.nmse"] == 0.04
    assert rows.loc["zero", "test.by_curvature.0.03 to 0.1.rmse_deg"] == pytest.approx(3 * 5.73)
    assert rows.loc["odometry_lidar", "test.nmse"] is None
    assert rows.loc["do", "paper.test_mse"] == 0.081
    assert rows.loc["ours", "paper.test_mse"] is None


def test_predictions_have_a_row_per_model_seed_and_frame(tmp_path: Path) -> None:
    found = examples.results(tmp_path, examples.metrics("net") | {"seeds": [3, 7]}, examples.metrics("other"))
    table = found.predictions
    assert table.groupby(["model", "run"]).size().to_dict() == {
        ("net", ""): 60,
        ("net", "seed-7"): 60,
        ("other", ""): 60,
    }
    first = found.first_seed(["net"])
    assert len(first) == 60
    row = first.iloc[[6, 10, 20]]
    assert row["elapsed_s"].tolist() == pytest.approx([0.6, 1.0, 2.0])
    np.testing.assert_allclose(row["driven_deg"], [np.rad2deg(0.06), np.rad2deg(0.1), np.nan])
    np.testing.assert_allclose(row["predicted_deg"], [np.nan, np.rad2deg(0.11), np.rad2deg(0.21)])
    np.testing.assert_allclose(row["odometry_deg"], np.rad2deg([0.061, 0.101, 0.201]))


def check_error(data: Path, name: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem) as raised:
        load_results(data / "evaluate", ["net"])
    assert f"net/{name}" in str(raised.value)
    assert "dvc repro --force --single-item evaluate@net" in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("keys", "value", "problem"),
    [
        (["model"], "../../other", "expected model net"),
        (["line"], [], "line"),
        (["line", "horizon"], "10", "line.horizon"),
        (["line", "fit_to"], None, "line.fit_to"),
        (["seeds"], [], "seeds"),
        (["parameters"], True, "parameters"),
        (["variant", "k"], -1, "variant.k"),
        (["test"], None, "test"),
        (["test", "nmse"], float("nan"), "test.nmse"),
        (["test", "mae_deg"], None, "all errors"),
        (["test", "nmse_ci95"], [0.1], "nmse_ci95"),
        (["test", "by_curvature"], {}, "by_curvature"),
        (["test", "by_drive", examples.DRIVES[0]], 3, "by_drive"),
        (["val"], {"nmse": 0.3}, "val.frames"),
        (["extra"], 1, "extra"),
    ],
)
def test_a_forged_metrics_file_is_one_error(tmp_path: Path, keys: list[str], value: Any, problem: str) -> None:
    content = inner = examples.metrics("net")
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    (tmp_path / "evaluate/net").mkdir(parents=True)
    (tmp_path / "evaluate/net/metrics.json").write_text(json.dumps(content))
    check_error(tmp_path, "metrics.json", problem)


@pytest.mark.parametrize(
    ("rows", "problem"),
    [('a,0,0.0,8.0,0.1,"0.2', "EOF"), ("a,0,0,8,0.1,inf,1,0,0\n", "finite"), ("a,0,0,8,0,0,1,0,0\n" * 2, "one row")],
)
def test_a_damaged_table_of_predictions_is_one_error(tmp_path: Path, rows: str, problem: str) -> None:
    examples.write_model(tmp_path, examples.metrics("net"))
    head = ",".join(examples.predictions(0.0).columns)
    (tmp_path / "evaluate/net/predictions.csv").write_text(f"{head}\n{rows}")
    check_error(tmp_path, "predictions.csv", problem)


def test_the_drives_with_the_largest_error_of_the_best_model_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.report.results.SHOWN_DRIVES", 1)
    table = examples.predictions(0.01)
    table.loc[table["drive"] == examples.DRIVES[1], "predicted_rad"] += 0.1
    examples.write_model(tmp_path, examples.metrics("best", nmse=0.1), table)
    examples.write_model(tmp_path, examples.metrics("worse", nmse=0.2))
    results = load_results(tmp_path / "evaluate", ["worse", "best"])
    shown = results.worst_drives(results.models)
    assert set(shown["drive"]) == {examples.DRIVES[1]}
    assert set(shown["model"]) == {"best", "worse"}


def test_a_forged_structure_is_one_error(tmp_path: Path) -> None:
    graph = {"frame": 1, "points": 2, "xyz_m": [[0, 0, 1], [1, 0, 1]], "cls": [0, 0], "edges": [[0, 2]]}
    store.write_json(tmp_path / "net/structure.json", {"drive": graph})
    with pytest.raises(InputError, match=r"structure\.json: .*do not fit"):
        load_structures(tmp_path / "net")


SEMANTIC = {
    "equivariant": False, "alpha": 0.0, "learning_rate": None, "features": 32, "input": "semantic", "spatial": "gnn",
    "temporal": "ncp", "window": 8, "cell": "ltc", "semantics": 1.0, "motion": "none", "horizon": 0, "fit_to": "train",
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "network"),
    [
        ({}, "sa-gnn-ncp"),
        ({"cell": "eq4", "features": 64}, "sa-gnn-ncp"),
        ({"cell": "cfc"}, None),
        ({"window": 4}, None),
        ({"accumulate": True}, None),
        ({"semantics": 0.0}, None),
        ({"input": "depth", "semantics": 0.0}, "do-gnn-ncp"),
    ],
)
def test_a_change_of_a_compared_setting_makes_another_network(change: dict[str, Any], network: str | None) -> None:
    assert paper.name({**SEMANTIC, **change}) == network


def test_every_network_of_the_paper_is_found() -> None:
    for name, published in paper.PAPER.items():
        assert paper.name({key: values[0] for key, values in published.settings.items()}) == name
        assert published.train_mse < published.test_mse
