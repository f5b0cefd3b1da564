"""steer diff: output and exit status."""

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
