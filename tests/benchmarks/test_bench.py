"""Test the command of `make bench`: its rows, its table and its file."""

import json
from pathlib import Path

import pytest
import typer

from benchmarks import bench
from benchmarks.row import Row

FAST, ALONE, DEMO = Row(2.0, 6.0, "ms", 3.0, "a / b"), Row(1.5, None, "GB", None, "c"), Row(300.0, None, "s", None, "d")


def failing() -> Row:
    raise ValueError("first line\nsecond line")


def use_rows(monkeypatch: pytest.MonkeyPatch, **rows: Row) -> None:
    monkeypatch.setattr(bench, "STREET_ROWS", {})
    monkeypatch.setattr(bench, "OTHER_ROWS", {name: lambda row=row: row for name, row in rows.items()})


def test_rows_are_printed_and_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    use_rows(monkeypatch, fast=FAST, alone=ALONE)
    bench.main(data=tmp_path, out=tmp_path / "results.json")
    printed = capsys.readouterr().out.splitlines()
    assert printed[2:4] == ["| fast | 2 | 6 | ms | 3 | a / b |", "| alone | 1.5 |  | GB |  | c |"]
    content = json.loads((tmp_path / "results.json").read_text())
    assert content["device"] == bench.device_name()
    assert content["rows"]["fast"] == {"ours": 2.0, "alternative": 6.0, "unit": "ms", "ratio": 3.0, "what": "a / b"}


def test_the_other_rows_are_measured_after_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    use_rows(monkeypatch, last=FAST)
    monkeypatch.setattr(bench, "OTHER_ROWS", {"first": failing, **bench.OTHER_ROWS})
    with pytest.raises(typer.Exit):
        bench.main(data=tmp_path, out=tmp_path / "results.json")
    assert "not measured: ValueError: first line |" in capsys.readouterr().out
    rows = json.loads((tmp_path / "results.json").read_text())["rows"]
    assert rows["first"] == {"error": "ValueError: first line"}
    assert rows["last"]["ratio"] == 3
