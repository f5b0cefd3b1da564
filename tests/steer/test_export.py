"""steer export as a user calls it."""

import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from steer.app import app
from tests.pipeline.live import untrained


def test_a_model_is_exported_and_verified(tmp_path: Path) -> None:
    model = untrained.save(untrained.model(tmp_path), tmp_path / "train")
    run, out = CliRunner(), tmp_path / "out"
    options = ["export", str(model), "--out", str(out), "--graphs", str(tmp_path / "graphs")]
    result = run.invoke(app, options)
    assert result.exit_code == 0
    assert f"{out / 'spatial.pt2'}: largest difference" in result.stdout
    assert "verified on 8 windows of 2026_01_03_drive_0001, 2026_01_01_drive_0001" in result.stdout
    content = json.loads(run.invoke(app, [*options, "--json"]).stdout)
    assert content["out"] == str(out)
    assert content["largest_difference"]["recurrent"] < 1e-5


def test_a_model_of_the_path_ahead_is_refused(tmp_path: Path) -> None:
    model = untrained.save(untrained.model(tmp_path, predict="path"), tmp_path / "train")
    arguments = [str(model), "--graphs", str(tmp_path / "graphs"), "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, ["export", *arguments])
    assert result.exit_code == 1
    assert result.stderr == "error: model net: predicts the path ahead, expected an angle. Choose another model\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("out", "named"), [("out", "no trained model"), (os.fsdecode(b"\xff"), "UTF-8")])
def test_errors_are_one_line(tmp_path: Path, out: str, named: str) -> None:
    result = CliRunner().invoke(app, ["export", str(tmp_path), "--out", str(tmp_path / out)])
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert named in result.stderr
