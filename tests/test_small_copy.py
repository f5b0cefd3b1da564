"""An experiment of DVC, a network added by a user, and a notebook, on a copy of the small chain."""

import csv
import io
import json
import re
import sys
from pathlib import Path

import pytest
import yaml

from tests import scratch
from tests.scratch import MODEL

pytestmark = pytest.mark.slow
NETWORK_STAGES = [f"train@{MODEL}", f"evaluate@{MODEL}", "report"]


@pytest.fixture(scope="module")
def swapped(chain: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy after an experiment with another recurrent network."""
    folder = scratch.duplicate(chain, tmp_path_factory.mktemp("swapped") / "copy")
    output = scratch.run(folder, "dvc", "exp", "run", "-S", f"models.{MODEL}.temporal=lstm")
    assert [stage for stage in scratch.stages_run(output) if stage != "check"] == NETWORK_STAGES
    return folder


def nmse(folder: Path) -> float:
    return json.loads((folder / f"data/evaluate/{MODEL}/metrics.json").read_text())["test"]["nmse"]


def test_an_experiment_edits_one_line_and_its_row_has_the_figure(swapped: Path) -> None:
    lines = scratch.run(swapped, "git", "diff", "-U0", "params.yaml").splitlines()
    before, after = (line for line in lines if re.match(r"[+-] +\w", line))  # comments of replaced sections are lost
    assert before.split()[:3] == ["-", "temporal:", "ncp"]
    assert after.split()[:3] == ["+", "temporal:", "lstm"]
    rows = list(csv.DictReader(io.StringIO(scratch.run(swapped, "dvc", "exp", "show", "--csv"))))
    (experiment,) = (row for row in rows if row["typ"] == "branch_base")
    assert float(experiment[f"{MODEL}.nmse"]) == pytest.approx(nmse(swapped))
    assert experiment[f"models.{MODEL}.temporal"] == "lstm"
    (baseline,) = (row for row in rows if row["typ"] == "baseline" and row["rev"] != "workspace")
    assert baseline[f"models.{MODEL}.temporal"] == "ncp"
    assert baseline[f"{MODEL}.nmse"] != experiment[f"{MODEL}.nmse"]


def test_a_network_is_added_by_a_file_and_its_edit_trains_its_models_alone(chain: Path, tmp_path: Path) -> None:
    folder = scratch.duplicate(chain, tmp_path / "copy")
    file = folder / "models/steering/spatial/height.py"
    network = scratch.code_block("class Height(nn.Module)").removeprefix("python\n")
    file.write_text(network)
    assert scratch.changed(folder) == {"check"}, "only check depends on all of models/"
    models = yaml.safe_load((folder / "params.yaml").read_text())["models"]
    mine = {"input": "semantic", "spatial": "height", "temporal": "lstm", "window": 4, "scale_m": 5.0, "semantics": 1.0}
    scratch.edit_params(folder, models=models | {"mine": mine})
    assert scratch.stages_run(scratch.run(folder, "dvc", "repro", "train@mine", "evaluate@mine")) == [
        "train@mine", "evaluate@mine",
    ]  # fmt: skip
    own = {"check", "train@mine", "evaluate@mine"}
    assert not own & scratch.changed(folder) - {"check"}
    file.write_text(network.replace("0.5", "0.4"))
    assert own <= scratch.changed(folder)
    assert f"train@{MODEL}" not in scratch.changed(folder)


def test_the_python_lines_of_the_readme_give_the_numbers_of_evaluate(chain: Path) -> None:
    snippet = scratch.code_block("predict.load(").removeprefix("python\n")
    assert len([line for line in snippet.splitlines() if line]) <= 6
    drive, frames = "2026_01_03_drive_0001", [7, 8, 12]
    snippet = re.sub(r"\d{4}_\d\d_\d\d_drive_\d{4}", drive, re.sub(r"\[\d+(, \d+)*\]", str(frames), snippet))
    printed = scratch.run(chain, sys.executable, "-c", snippet + "\nprint(steering_rad.tolist())")
    with (chain / f"data/evaluate/{MODEL}/predictions.csv").open() as file:
        rows = {(row["drive"], int(row["frame"])): row["predicted_rad"] for row in csv.DictReader(file)}
    expected = [float(rows[drive, frame]) for frame in frames]
    assert json.loads(printed) == pytest.approx(expected, abs=1e-6)
