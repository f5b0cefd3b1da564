import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.provenance import ROOT
from pipeline.report import studies
from pipeline.report.judge.interval import difference_interval, nmse_interval
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


@pytest.mark.slow
def test_a_figure_and_a_table_of_each_study_that_has_models(evaluate: Path, tmp_path: Path) -> None:
    out = studies.main(evaluate, tmp_path / "report/studies", ROOT / "params.yaml")
    assert sorted(path.name for path in out.iterdir()) == ["keep.png", "lambda.png", "points.png"]
    with out.with_suffix(".csv").open(newline="") as file:
        rows = [(row["study"], row["value"], row["model"]) for row in csv.DictReader(file)]
    assert rows[:3] == [
        ("points", "125", "points-125"),
        ("points", "1000", "sa-gnn-ncp"),
        ("points", "8000", "points-8000"),
    ]
    text = out.with_suffix(".md").read_text()
    assert "## points: points a frame" in text
    assert "## roads" not in text
    before = (out / "points.png").read_bytes()
    studies.main(evaluate, out, ROOT / "params.yaml")
    assert (out / "points.png").read_bytes() == before


def test_claims_are_judged_by_the_interval_of_the_difference(evaluate: Path, tmp_path: Path) -> None:
    text = studies.main(evaluate, tmp_path / "studies", ROOT / "params.yaml").with_suffix(".md").read_text()
    claims = [line for line in text.splitlines() if line.startswith("- ")]
    assert len(claims) == 2  # no LSTM here
    assert claims[0].startswith("- pruning")
    assert "no difference shown" in claims[0]
    assert claims[1].startswith("- semantics")
    assert ": better." in claims[1]


def test_without_the_default_there_is_no_study(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no model 'sa-gnn-ncp': run make studies"):
        studies.main(tmp_path / "nothing", tmp_path / "out")


def test_the_difference_of_two_models_is_surer_than_either() -> None:
    rng = np.random.default_rng(0)
    steering, drive = np.sin(np.arange(600) / 30), np.repeat([0, 1], 300)
    hard = np.repeat(rng.uniform(0, 1, 12), 50)  # the same roads are hard for both
    one, other = (steering + (hard * rng.normal(size=(2, 600)) * size) for size in (0.5, 0.55))
    low, high = difference_interval(steering, one, other, drive, 50, 500, 0)
    alone = nmse_interval(steering, one, drive, 50, 500, 0)
    assert high - low < 0.5 * (alone[1] - alone[0])
    assert difference_interval(steering, one, one, drive, 50, 100, 0) == (0.0, 0.0)
