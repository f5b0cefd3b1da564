"""Groups of models: order of the rows, baselines, angles in degrees, networks of the paper."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.report import paper
from pipeline.report.results import load_groups
from tests.pipeline.report import examples
from tests.pipeline.report.examples import metrics


def test_groups_and_rows_are_sorted_with_baselines_last(tmp_path: Path) -> None:
    found = examples.groups(
        tmp_path,
        metrics("path", predict="path"),
        metrics("far", odometry={"odometry": 0.5}, horizon=10),
        metrics("ours", spatial="polar", odometry={"odometry": 0.04}),
        metrics("do", input="depth", semantics=0.0),
        metrics("lstm", input="lidar-50k", temporal="lstm", semantics=0.0),
    )
    assert [group.title for group in found] == ["steering angle", "steering angle, 10 frames ahead", "path ahead"]
    baselines = ["zero", "train_mean", "persistence"]
    rows = {row["model"]: row for row in found[0].rows}
    assert [*rows] == ["lstm", "do", "ours", *baselines, "odometry"]
    assert [row["baseline"] for row in rows.values()] == [False] * 3 + [True] * 4
    assert rows["odometry"]["test"]["steering_rad"]["nmse"] == 0.04
    assert rows["do"]["paper"].test_mse == 0.081
    assert rows["ours"]["paper"] is None
    assert [*found[2].labels.values()] == ["0-5 m", "5-10 m"]


def test_predictions_have_a_row_per_model_seed_and_frame(tmp_path: Path) -> None:
    (group,) = examples.groups(tmp_path, metrics("net") | {"seeds": [3, 7]}, metrics("other"))
    counts = group.predictions.groupby(["model", "run"]).size().to_dict()
    assert counts == {("net", ""): 60, ("net", "seed-7"): 60, ("other", ""): 60}
    row = group.first_seed("net").iloc[[0, 6, 10, 20]]
    assert row["elapsed_s"].tolist() == pytest.approx([0, 0.6, 1.0, 2.0])
    np.testing.assert_allclose(row["true_deg"], np.rad2deg([0, 0.06, 0.1, np.nan]))
    np.testing.assert_allclose(row["predicted_deg"], np.rad2deg([np.nan, np.nan, 0.11, 0.21]))
    np.testing.assert_allclose(row["odometry_deg"], np.rad2deg([np.nan, 0.061, 0.101, 0.201]))


def test_a_path_turns_by_its_curvature_times_its_length(tmp_path: Path) -> None:
    (group,) = examples.groups(tmp_path, metrics("path", predict="path"))
    row = group.first_seed("path").iloc[10]
    assert (row["true_deg"], row["predicted_deg"]) == pytest.approx((np.rad2deg(0.1 * 10), np.rad2deg(0.11 * 10)))


def test_the_drives_with_the_largest_error_of_the_best_model_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.report.results.SHOWN_DRIVES", 1)
    table = examples.predictions(0.01)
    table.loc[table["drive"] == examples.DRIVES[1], "predicted_steering_rad"] += 0.1
    examples.write_model(tmp_path, metrics("worse", nmse=0.2))
    examples.write_model(tmp_path, metrics("best", nmse=0.1), table)
    (group,) = load_groups(tmp_path / "evaluate", ["worse", "best"])
    assert group.worst_drives() == [examples.DRIVES[1]]


@pytest.mark.parametrize(
    ("change", "network"),
    [
        ({}, "sa-gnn-ncp"),
        ({"cell": "eq4", "features": 64}, "sa-gnn-ncp"),
        ({"cell": "cfc"}, None),
        ({"window": 4}, None),
        ({"predict": "path"}, None),
        ({"accumulate": {"frames": 8}}, None),
        ({"semantics": 0.0}, None),
        ({"input": "depth", "semantics": 0.0}, "do-gnn-ncp"),
    ],
)
def test_a_change_of_a_compared_setting_makes_another_network(change: dict[str, Any], network: str | None) -> None:
    assert paper.name(examples.ENTRY | change) == network


def test_every_network_of_the_paper_is_found() -> None:
    for name, published in paper.PAPER.items():
        assert paper.name({key: values[0] for key, values in published.settings.items()}) == name
        assert published.train_mse < published.test_mse
