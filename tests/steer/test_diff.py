"""steer diff: output and exit status."""

import json
from pathlib import Path

from typer.testing import CliRunner, Result

from pipeline.base import store
from steer.app import app


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["diff", *map(str, arguments)])


def test_exit_status_and_output(tmp_path: Path) -> None:
    for name in "ab":
        store.write_json(tmp_path / name / "metrics.json", {"nmse": 0.25, "frames": list(range(30))})
    a, b = tmp_path / "a", tmp_path / "b"
    result = run(a, b)
    assert (result.exit_code, result.stdout) == (0, "equal\n")
    store.write_json(b / "metrics.json", {"nmse": 0.5, "frames": list(range(30))})
    result = run(a, b)
    assert result.exit_code == 3
    assert "metrics.json: nmse: 0.25 and 0.5" in result.stdout
    assert run(a / "metrics.json", b / "metrics.json", "--tolerance", 0.25).exit_code == 0
    result = run(a, b, "--quiet")
    assert (result.exit_code, result.stdout) == (3, "")
    result = run(a, tmp_path / "none")
    assert (result.exit_code, result.stdout) == (1, "")
    assert run(a).exit_code == 2


def test_text_has_the_first_differences_and_json_all(tmp_path: Path) -> None:
    for name, shift in (("a", 0), ("b", 1)):
        store.write_json(tmp_path / name / "x.json", {"values": [n + shift for n in range(30)]})
        (tmp_path / name / "same.txt").write_text("same")
    lines = run(tmp_path / "a", tmp_path / "b").stdout.splitlines()
    assert len(lines) == 22
    assert "10 more" in lines[-2]
    assert "1 of 2" in lines[-1]
    content = json.loads(run(tmp_path / "a", tmp_path / "b", "--json").stdout)
    assert (content["equal"], content["files"], content["different"]) == (False, 2, 1)
    assert len(content["differences"]) == 30
    first = content["differences"][0]
    assert (first["file"], first["key"], first["problem"], first["largest"]) == ("x.json", "values[0]", "0 and 1", 1.0)
