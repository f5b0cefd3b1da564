"""steer diff as a user calls it: what it says, and its exit status."""

import json
from pathlib import Path

from typer.testing import CliRunner, Result

from pipeline.base import store
from steer.app import app


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["diff", *map(str, arguments)])


def test_its_exit_status_tells_equal_different_and_wrong(tmp_path: Path) -> None:
    for name in "ab":
        store.write_json(tmp_path / name / "metrics.json", {"nmse": 0.25, "frames": list(range(30))})
    a, b = tmp_path / "a", tmp_path / "b"
    ended = run(a, b)
    assert (ended.exit_code, ended.stdout) == (0, "equal: 1 files\n")

    store.write_json(b / "metrics.json", {"nmse": 0.5, "frames": list(range(30))})
    ended = run(a, b)
    assert ended.exit_code == 3
    assert ended.stdout == "metrics.json: nmse: 0.25 and 0.5, largest difference 0.25\n1 of 1 files differ\n"
    ended = run(a / "metrics.json", b / "metrics.json", "--tolerance", 0.25)
    assert (ended.exit_code, ended.stdout) == (0, "equal: 1 files (tolerance 0.25)\n")
    ended = run(a, b, "--quiet")
    assert (ended.exit_code, ended.stdout) == (3, "")

    ended = run(a, tmp_path / "none")
    assert (ended.exit_code, ended.stdout) == (1, "")
    assert ended.stderr == f"error: {tmp_path / 'none'} is missing: name two files, or two folders\n"
    assert run(a).exit_code == 2
    assert "Exit status: 0 equal, 3 different, 1 an error, 2 a wrong option." in run("--help").stdout


def test_json_has_all_of_it_and_lines_the_first(tmp_path: Path) -> None:
    for name, shift in (("a", 0), ("b", 1)):
        store.write_json(tmp_path / name / "x.json", {"values": [n + shift for n in range(30)]})
        (tmp_path / name / "same.txt").write_text("same")
    lines = run(tmp_path / "a", tmp_path / "b").stdout.splitlines()
    assert len(lines) == 22
    assert lines[-2:] == ["x.json: and 10 more; --json has all", "1 of 2 files differ"]
    said = json.loads(run(tmp_path / "a", tmp_path / "b", "--json").stdout)
    assert (said["equal"], said["files"], said["different"], len(said["differences"])) == (False, 2, 1, 30)
    first = said["differences"][0]
    assert (first["file"], first["where"], first["how"], first["largest"]) == ("x.json", "values[0]", "0 and 1", 1.0)
