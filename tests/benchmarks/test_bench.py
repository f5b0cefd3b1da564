"""make bench's command: its rows, its table and its file."""

import json
from pathlib import Path

import pytest

from benchmarks import bench
from benchmarks.rows.row import Row
from pipeline.base.errors import InputError

ASKED = {
    "gcn_vs_pyg_edge_index", "gcn_vs_pyg_csr", "gcn_vs_linear", "equivariant_vs_plain", "windows_vs_naive", "step_ms",
    "peak_memory_gb", "graph_build", "graphs_stage_fps", "bytes", "load", "ltc", "pointnet2", "blocks", "demo",
    "table2_side_by_side",
}  # fmt: skip


def test_all_rows_are_there() -> None:
    assert set(bench.rows()) >= ASKED


def test_an_unknown_row_is_named() -> None:
    with pytest.raises(InputError, match=r"no row 'gcn_vs_linea'.*gcn_vs_linear"):
        bench.main(["gcn_vs_linea"])


def test_rows_are_printed_and_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    rows = {
        "fast": lambda given: Row(2.0, 6.0, "ms", 3.0, "a / b"),
        "alone": lambda given: Row(1.5, None, "GB", None, "c"),
    }
    monkeypatch.setattr(bench, "rows", lambda: rows)
    bench.main(data=tmp_path, out=tmp_path / "results.json")
    printed = capsys.readouterr().out.splitlines()
    assert printed[2:4] == ["| fast | 2 | 6 | ms | 3 | a / b |", "| alone | 1.5 |  | GB |  | c |"]
    content = json.loads((tmp_path / "results.json").read_text())
    assert content["device"] == bench.device()
    assert content["rows"]["fast"] == {"ours": 2.0, "peer": 6.0, "unit": "ms", "ratio": 3.0, "what": "a / b"}
    assert content["rows"]["alone"]["ratio"] is None


def test_a_row_measured_by_name_joins_those_that_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {
        "fast": lambda given: Row(2.0, 6.0, "ms", 3.0, "a / b"),
        "demo": lambda given: Row(300.0, None, "s", None, "c"),
    }
    monkeypatch.setattr(bench, "rows", lambda: rows)
    for names, written in (None, ["fast"]), (["demo"], ["fast", "demo"]), (None, ["fast"]):
        bench.main(names, data=tmp_path, out=tmp_path / "results.json")
        assert list(json.loads((tmp_path / "results.json").read_text())["rows"]) == written


def test_a_row_that_fails_is_named_and_the_others_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    def failing(given: bench.Given) -> Row:
        raise ValueError("it fails\nat length")

    monkeypatch.setattr(bench, "rows", lambda: {"a": failing, "b": lambda given: Row(1, 2, "s", 2, "")})
    with pytest.raises(bench.typer.Exit):
        bench.main(data=tmp_path, out=tmp_path / "results.json")
    assert "| a |  |  |  |  | not measured: ValueError: it fails |" in capsys.readouterr().out
    rows = json.loads((tmp_path / "results.json").read_text())["rows"]
    assert rows["a"] == {"error": "ValueError: it fails"}
    assert rows["b"]["ratio"] == 2


def test_a_peer_that_is_not_installed_is_named_and_no_failure(tmp_path: Path, monkeypatch, capsys) -> None:
    def missing(given: bench.Given) -> Row:
        raise ModuleNotFoundError("No module named 'peer'")

    monkeypatch.setattr(bench, "rows", lambda: {"a": missing})
    bench.main(data=tmp_path)
    assert "not measured: ModuleNotFoundError: No module named 'peer'" in capsys.readouterr().out


def test_without_a_sample_it_says_what_makes_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="make demo"):
        _ = bench.Given(None, tmp_path, tmp_path).sample
