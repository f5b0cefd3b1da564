import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.base.params import load
from pipeline.base.resume import ROOT
from pipeline.report.judge.interval import difference_interval, nmse_interval
from pipeline.report.studies import claims, figure, study, tables
from pipeline.sections import preset
from pipeline.sections.evaluate import Evaluate
from tests.pipeline.report.tables.results import result, scores


def write_model(evaluate: Path, name: str, nmse: float, seeds: tuple[int, ...] = (0, 1), **more: Any) -> None:
    """Write what stage evaluate leaves of a model whose errors are `nmse` of the labels' square."""
    folder = evaluate / name
    metrics = result(name, nmse) | {"seeds": list(seeds), "val": scores(nmse)} | more
    for seed in seeds:
        of_seed = folder if seed == seeds[0] else folder / f"seed-{seed}"
        of_seed.mkdir(parents=True)
        truth = 0.1 * np.sin(np.arange(200) / 15)
        noise = 0.1 / np.sqrt(2) * np.sqrt(nmse) * np.random.default_rng([seed, len(name)]).normal(size=200)
        with (of_seed / "predictions.csv").open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["drive", "frame", "time_s", "speed_mps", "steering_rad", "predicted_rad", "valid"])
            for frame in range(200):
                predicted = "" if frame < 7 else truth[frame] + noise[frame]
                rows.writerow(["one" if frame < 100 else "two", frame, 0.1 * frame, 8, truth[frame], predicted, 1])
    (folder / "metrics.json").write_text(json.dumps(metrics))


@pytest.fixture
def evaluate(tmp_path: Path) -> Path:
    folder = tmp_path / "evaluate"
    for name, nmse in {
        "sa-gnn-ncp": 0.2,
        "points-125": 0.6,
        "points-8000": 0.15,
        "keep-100": 0.2,
        "lambda-0": 0.8,
    }.items():
        write_model(folder, name, nmse)
    return folder


@pytest.fixture
def results(evaluate: Path) -> list[study.Result]:
    return [json.loads((folder / "metrics.json").read_text()) for folder in sorted(evaluate.iterdir())]


def test_points_are_by_value_with_the_default_among_them(results: list[study.Result]) -> None:
    points = study.points(results)
    assert list(points) == ["points", "keep", "lambda"]
    assert [(value, result["model"]) for value, result in points["points"]] == [
        (125, "points-125"),
        (1000, "sa-gnn-ncp"),
        (8000, "points-8000"),
    ]
    assert study.points([result for result in results if result["model"] != "sa-gnn-ncp"]) == {}


def test_the_preset_has_models_of_every_study() -> None:
    names = preset.merged("studies")["models"]
    assert study.DEFAULT in names
    for name in study.STUDIES:
        assert [model for model in names if re.fullmatch(rf"{name}-\d+", model)]
    assert {model for claim in claims.CLAIMS for model in claim[1:]} <= names.keys()


@pytest.mark.parametrize("val", [True, False])
def test_a_table_of_each_study(results: list[study.Result], val: bool) -> None:
    for each in results:
        each["val"] = each["val"] if val else None
    points = study.points(results)["points"]
    text = "\n".join(tables.markdown("points", points))
    assert "| points a frame | test nmse |" in text
    assert "| 8000 | 0.150 | 0.075 to 0.225 | " + ("0.150" if val else "none") in text
    row = tables.rows("points", points)[0]
    assert (row["study"], row["value"], row["model"], row["seeds"]) == ("points", "125", "points-125", 2)
    assert row["val_nmse"] == (0.6 if val else None)


@pytest.mark.slow
def test_a_figure_of_a_study(results: list[study.Result], tmp_path: Path) -> None:
    points = study.points(results)["points"]
    points[0][1]["test"]["baselines"]["odometry"] = {"nmse": None}
    points[1][1]["val"] = None

    def drawn() -> bytes:
        figure.draw(tmp_path / "points.png", study.STUDIES["points"], points)
        return (tmp_path / "points.png").read_bytes()

    assert drawn() == drawn()


def test_claims_are_judged_by_the_interval_of_the_difference(results: list[study.Result], evaluate: Path) -> None:
    settings = load(Evaluate, ROOT / "params.yaml")
    said = [line for line in claims.markdown(results, evaluate, settings) if line.startswith("- ")]
    assert len(said) == 2  # no LSTM here
    assert said[0].startswith("- pruning")
    assert "no difference shown" in said[0]
    assert said[1].startswith("- semantics")
    assert ": better." in said[1]
    assert claims.markdown(results[:1], evaluate, settings) == []


def test_the_difference_of_two_models_is_surer_than_either() -> None:
    rng = np.random.default_rng(0)
    steering, drive = np.sin(np.arange(600) / 30), np.repeat([0, 1], 300)
    hard = np.repeat(rng.uniform(0, 1, 12), 50)  # the same roads are hard for both
    one, other = (steering + (hard * rng.normal(size=(2, 600)) * size) for size in (0.5, 0.55))
    low, high = difference_interval(steering, one, other, drive, 50, 500, 0)
    alone = nmse_interval(steering, one, drive, 50, 500, 0)
    assert high - low < 0.5 * (alone[1] - alone[0])
    assert difference_interval(steering, one, one, drive, 50, 100, 0) == (0.0, 0.0)
