"""Studies of one setting: table, figure, and claims."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from pipeline.base.params import load
from pipeline.base.resume import ROOT
from pipeline.report import studies
from pipeline.report.results import Results, load_results
from pipeline.settings.evaluate import Evaluate
from tests.pipeline.report import examples

MODELS = {"sa-gnn-ncp": 0.2, "points-125": 0.6, "points-8000": 0.15, "keep-100": 0.2, "lambda-0": 0.8}


def write_model(data: Path, name: str, nmse: float, **more: Any) -> None:
    frame = np.arange(200)
    truth = 0.1 * np.sin(frame / 15)
    noise = 0.1 / np.sqrt(2) * np.sqrt(nmse) * np.random.default_rng(len(name)).normal(size=200)
    table = pd.DataFrame({
        "drive": np.where(frame < 100, "one", "two"), "frame": frame, "time_s": 0.1 * frame, "speed_mps": 8.0,
        "steering_rad": truth, "predicted_rad": np.where(frame < 7, np.nan, truth + noise), "valid": 1, "onset": 0,
        "odometry_rad": np.nan,
    })  # fmt: skip
    content = examples.metrics(name, nmse, {"odometry": 0.1}) | {"seeds": [0, 1], "val": examples.scores(nmse)} | more
    examples.write_model(data, content, table)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    data = tmp_path_factory.mktemp("studies")
    for name, nmse in MODELS.items():
        write_model(data, name, nmse, **({"val": None} if name == "points-125" else {}))
    return load_results(data / "evaluate", [*MODELS])


def test_files_of_studies_and_claims(results: Results, tmp_path: Path) -> None:
    settings = load(Evaluate, ROOT / "params.yaml")
    text = studies.write(results, tmp_path, settings)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["keep.png", "lambda.png", "points.png", "studies.md"]
    assert (tmp_path / "studies.md").read_text() == f"{text}\n"
    pruning, semantics = [line for line in text.splitlines() if line.startswith("- ")]  # no LSTM here
    assert "no difference shown" in pruning
    assert semantics.startswith("- semantics: λ = 1 against 0: better.")
    assert studies.write(load_results(tmp_path, []), tmp_path / "none", settings) == ""
