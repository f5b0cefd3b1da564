"""The complete chain as a user runs it, by `dvc repro` in a scratch copy."""

import json
from pathlib import Path

import h5py
import pytest
import yaml

from pipeline.base import store
from tests import scratch
from tests.scratch import MODEL, STAGES

pytestmark = pytest.mark.slow


def test_every_stage_runs_once_in_order(chain: Path) -> None:
    ran = [name.split("@")[0] for name in scratch.stages_run((chain / "chain.log").read_text())]
    assert ran.count("graphs") == 2
    assert tuple(name for name in dict.fromkeys(ran) if name in STAGES) == STAGES
    assert set(STAGES) == {path.name for path in (chain / "data").iterdir() if path.is_dir()} - {".resume"}


def test_the_table_has_the_numbers_of_evaluate_and_scores(chain: Path) -> None:
    table = (chain / "data/report/table.md").read_text()
    nmse = json.loads((chain / f"data/evaluate/{MODEL}/metrics.json").read_text())["test"]["nmse"]
    accuracy = json.loads((chain / "data/scores/metrics.json").read_text())["test"]["classes"]["pixel_accuracy"]
    assert any(f"{nmse:.3f}" in row for row in table.splitlines() if row.startswith(f"| {MODEL}"))
    assert f"{accuracy:.3f}" in table


def test_faults_are_one_line_and_leave_all_outputs(chain: Path, tmp_path: Path) -> None:
    folder = scratch.duplicate(chain, tmp_path / "copy")
    output = scratch.run(folder, "dvc", "repro")
    assert scratch.stages_run(output) == []
    params = (folder / "params.yaml").read_text()
    (folder / "params.yaml").write_text(params.replace("input: semantic", "input: semantc"))
    check_refused(scratch.run(folder, "dvc", "repro", check=False), f"models.{MODEL}: input", "semantc")
    (folder / "params.yaml").write_text(params)

    scan = sorted((folder / "data/sample/2026_01_01/2026_01_01_drive_0001_sync/velodyne_points/data").iterdir())[3]
    content = scan.read_bytes()
    scan.write_bytes(content[:-7])
    output = scratch.run(folder, "dvc", "repro", "ingest", "--single-item", check=False)
    check_refused(output, "drive_0001_sync/velodyne_points", scan.name)
    scan.write_bytes(content)
    assert scratch.outputs(folder, *STAGES) == scratch.outputs(chain, *STAGES)


def test_one_word_changes_the_source_of_labels_which_then_need_no_oxts(chain: Path, tmp_path: Path) -> None:
    folder = scratch.duplicate(chain, tmp_path / "copy")
    params = yaml.safe_load((folder / "params.yaml").read_text())
    scratch.edit_params(folder, labels=params["labels"] | {"source": "visual"})
    assert scratch.changed(folder) == {"check", "labels"}
    drives = store.read_index(folder / "data/ingest", stage="ingest")
    for drive in drives:
        with h5py.File(folder / f"data/ingest/{drive}.h5", "a") as file:
            del file["oxts"]
    for stage in ("labels", "scores"):
        scratch.run(folder, "python", "-m", f"stages.{stage}")
    for drive in drives:
        with store.DriveReader(folder / f"data/labels/{drive}.h5", stage="labels") as labels:
            assert labels.params["labels"]["source"] == "visual"
    assert json.loads((folder / "data/scores/metrics.json").read_text())["motion"] == {}


def check_refused(output: str, *parts: str) -> None:
    (line,) = (line for line in output.splitlines() if line.startswith("error: "))
    assert all(part in line for part in parts), line
    assert "Traceback" not in output


def check_same_bytes(chain: Path, folder: Path, workers: dict[str, int]) -> None:
    """Run stages again, by hand, with numbers of workers; their outputs must be those of one worker."""
    scratch.duplicate(chain, folder)
    for stage, number in workers.items():
        for entry in yaml.safe_load((folder / "params.yaml").read_text())["graphs"] if stage == "graphs" else [""]:
            command = [f"STEER_WORKERS={number}", "python", "-m", f"stages.{stage}", *([entry] if entry else [])]
            scratch.run(folder, "env", *command)
    assert scratch.outputs(folder, *workers) == scratch.outputs(chain, *workers)


def test_bytes_do_not_depend_on_workers(chain: Path, tmp_path: Path) -> None:
    """The chain ran with one."""
    check_same_bytes(chain, tmp_path / "copy", {"sample": 3, "ingest": 2, "perception": 2, "clouds": 3, "graphs": 2})
