"""steer export as a user calls it."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pipeline.live.export import programs
from steer.app import app
from tests.pipeline.live.export import untrained

pytestmark = pytest.mark.slow


def test_a_model_becomes_files_and_a_line_for_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programs, "find_spec", lambda name: None)
    model = untrained.save(untrained.model(tmp_path), tmp_path / "train")
    run, out = CliRunner(), tmp_path / "out"
    given = ["export", str(model), "--out", str(out), "--graphs", str(tmp_path / "graphs")]
    ended = run.invoke(app, given)
    assert ended.exit_code == 0
    assert "no spatial.onnx: onnx, onnxscript, onnxruntime not installed" in ended.stdout
    assert "spatial.pt2: differs from the network by " in ended.stdout
    assert f"{out}: net, verified on 8 windows of 2026_01_03_drive_0001, 2026_01_01_drive_0001" in ended.stdout
    said = json.loads(run.invoke(app, [*given, "--json"]).stdout)
    assert said["out"] == str(out)
    assert said["verified"]["largest_difference"]["recurrent.pt2"] < 1e-5
    assert run.invoke(app, [*given, "--quiet"]).stdout == ""


def test_errors_are_a_line(tmp_path: Path) -> None:
    run = CliRunner()
    ended = run.invoke(app, ["export", str(tmp_path), "--out", str(tmp_path / "out")])
    assert ended.exit_code == 1
    assert ended.stderr.count("\n") == 1
    assert "is not a trained model" in ended.stderr
    assert "steer export data/train/sa-gnn-ncp --out out/sa-gnn-ncp" in run.invoke(app, ["export", "--help"]).stdout
