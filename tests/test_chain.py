"""The complete chain as a user runs it, by `dvc repro` in a scratch copy."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from dvc.repo import Repo

from tests import scratch
from tests.scratch import MODEL, STAGES

pytestmark = pytest.mark.slow
NETWORK = [f"train@{MODEL}", f"evaluate@{MODEL}"]


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small chain that has run to its end; tests read it, or work in a copy."""
    return scratch.small_chain(tmp_path_factory.mktemp("chain") / "chain")


def test_every_stage_runs_once_in_order(chain: Path) -> None:
    ran = [name.split("@")[0] for name in scratch.stages_run((chain / "chain.log").read_text())]
    assert ran.count("graphs") == 2
    assert tuple(name for name in dict.fromkeys(ran) if name in STAGES) == STAGES
    assert set(STAGES) == {path.name for path in (chain / "data").iterdir() if path.is_dir()} - {".drives", ".resume"}


def test_the_table_has_the_numbers_of_evaluate_and_scores(chain: Path) -> None:
    table = (chain / "data/report/table.md").read_text()
    nmse = json.loads((chain / f"data/evaluate/{MODEL}/metrics.json").read_text())["test"]["steering_rad"]["nmse"]
    accuracy = json.loads((chain / "data/scores/metrics.json").read_text())["test"]["classes"]["pixel_accuracy"]
    assert any(f"{nmse:.3f}" in row for row in table.splitlines() if row.startswith(f"| {MODEL}"))
    assert f"{accuracy:.3f}" in table


def test_the_python_lines_of_the_readme_give_the_numbers_of_evaluate(
    chain: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(chain)
    drive, names = "2026_01_03_drive_0001", dict[str, Any]()
    snippet = scratch.code_block("predict.load(").removeprefix("python\n")
    assert len([line for line in snippet.splitlines() if line]) <= 6
    exec(re.sub(r"\d{4}_\d\d_\d\d_drive_\d{4}", drive, snippet), names)
    with Path(f"data/evaluate/{MODEL}/predictions.csv").open() as file:
        expected = [
            float(row["predicted_steering_rad"] or "nan") for row in csv.DictReader(file) if row["drive"] == drive
        ]
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(names["steering_rad"], expected, atol=1e-6)


EDITS: list[tuple[str, set[str]]] = [  # a file or a setting, and the stages that run again; more: test_dvc_yaml.py
    ("pipeline/train/__pycache__/fit.cpython-311.pyc", set()),  # what an editor or Python leaves
    ("stages/labels.py~", set()),
    ("pipeline/train/fit.py", {"check", *NETWORK}),
    ("train.epochs", {"check", NETWORK[0]}),
    ("models/steering/spatial/gnn.py", {"check", *NETWORK}),
    ("models/steering/spatial/polar.py", {"check"}),
    ("labels.max_stand_s", {"check", "labels"}),
]


def test_an_edit_reruns_what_dvc_yaml_promises(chain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stages with changed deps or params; DVC runs those after them only if their inputs differ."""
    folder = scratch.duplicate(chain, tmp_path / "copy")
    monkeypatch.chdir(folder)  # DVC names stages relative to it
    for name, expected in EDITS:
        path = folder / (name if "/" in name else "params.yaml")
        before = path.read_bytes() if path.exists() else None
        path.parent.mkdir(exist_ok=True)
        if "/" in name:
            path.write_bytes((before or b"") + b"\n# an edit\n")
        else:
            section, key = name.split(".")
            params = yaml.safe_load(before or b"")
            scratch.edit_params(folder, **{section: params[section] | {key: params[section][key] + 1}})
        with Repo() as repo:
            assert set(repo.status()) == expected, name
        path.write_bytes(before) if before else path.unlink()


def test_faults_are_one_line_and_leave_all_outputs(chain: Path, tmp_path: Path) -> None:
    folder = scratch.duplicate(chain, tmp_path / "copy")
    params = (folder / "params.yaml").read_text()
    (folder / "params.yaml").write_text(params.replace("input: semantic", "input: semantc"))
    check_refused(scratch.run(folder, "dvc", "repro", check=False), f"models.{MODEL}: input", "semantc")
    name = "x';touch pwned;'$(touch pwned)\"`touch pwned`"
    (folder / "params.yaml").write_text(params)
    scratch.edit_params(folder, graphs={name: {"source": "clouds/pseudo", "points": 100, "k": 6}})
    check_refused(scratch.run(folder, "dvc", "repro", "--single-item", "graphs", check=False), "graphs: name")
    assert not (folder / "pwned").exists()
    (folder / "params.yaml").write_text(params)

    scan = sorted((folder / "data/sample/2026_01_01/2026_01_01_drive_0001_sync/velodyne_points/data").iterdir())[3]
    content = scan.read_bytes()
    scan.write_bytes(content[:-7])
    output = scratch.run(folder, "dvc", "repro", "ingest", "--single-item", check=False)
    check_refused(output, "drive_0001_sync/velodyne_points", scan.name)
    scan.write_bytes(content)
    assert scratch.outputs(folder, *STAGES) == scratch.outputs(chain, *STAGES)


def check_refused(output: str, *parts: str) -> None:
    (line,) = (line for line in output.splitlines() if line.startswith("error: "))
    assert all(part in line for part in parts), line
    assert "Traceback" not in output


def test_bytes_do_not_depend_on_workers(chain: Path, tmp_path: Path) -> None:
    """The chain ran with one."""
    folder = scratch.duplicate(chain, tmp_path / "copy")
    stages = {"sample": 3, "ingest": 2, "perception": 2, "clouds": 3, "graphs": 2}
    for stage, number in stages.items():
        for entry in yaml.safe_load((folder / "params.yaml").read_text())["graphs"] if stage == "graphs" else [""]:
            command = [f"STEER_WORKERS={number}", "python", "-m", f"stages.{stage}", *([entry] if entry else [])]
            scratch.run(folder, "env", *command)
    assert scratch.outputs(folder, *stages) == scratch.outputs(chain, *stages)


def test_a_new_drive_costs_one_drive_per_stage(chain: Path, tmp_path: Path) -> None:
    folder = scratch.duplicate(chain, tmp_path / "copy")
    ingest = yaml.safe_load((folder / "params.yaml").read_text())["ingest"]
    ingest["drives"]["val"] = ["2026_01_02_drive_0001..0002"]
    scratch.edit_params(folder, ingest=ingest)
    output = scratch.run(folder, "dvc", "repro", "graphs", "labels", "scores")
    ran = [stage for stage in scratch.stages_run(output) if stage not in ("check", "encoder")]
    assert {stage.split("@")[0] for stage in ran} == {*STAGES[:9]} - {"encoder"}
    kept = re.findall(r"(\d+) of (\d+) drives kept from earlier runs", output)
    assert kept == [("4", "5")] * (len(ran) + 1)  # stage clouds makes them of images and of scans


def test_a_network_is_added_by_a_file_and_trained_alone(chain: Path, tmp_path: Path) -> None:
    folder = scratch.duplicate(chain, tmp_path / "copy")
    network = scratch.code_block("class Height(nn.Module)").removeprefix("python\n")
    (folder / "models/steering/spatial/height.py").write_text(network)
    models = yaml.safe_load((folder / "params.yaml").read_text())["models"]
    mine = {"input": "semantic", "spatial": "height", "temporal": "lstm", "window": 4, "semantics": 1.0}
    scratch.edit_params(folder, models=models | {"mine": mine})
    ran = scratch.stages_run(scratch.run(folder, "dvc", "repro", "train@mine", "evaluate@mine"))
    assert ran == ["train@mine", "evaluate@mine"]


def test_a_second_machine_trains_the_same_network_on_the_firsts_graphs(chain: Path, tmp_path: Path) -> None:
    first, second = scratch.duplicate(chain, tmp_path / "first"), tmp_path / "second"
    content = yaml.safe_load((first / "dvc.lock").read_text())
    for name in (*NETWORK, "report"):  # all but the model is shared
        del content["stages"][name]
    (first / "dvc.lock").write_text(yaml.safe_dump(content))
    scratch.run(first, "sh", "-c", f"dvc remote add -d lab {tmp_path}/folder && dvc push")
    scratch.commit(first, "shared")
    scratch.run(tmp_path, "git", "clone", "-q", str(first), str(second))
    command = f"dvc repro --pull --downstream train@{MODEL}"
    assert scratch.code_block(command)
    assert scratch.stages_run(scratch.run(second, *command.split())) == [*NETWORK, "report"]
    fetched = {str(path.relative_to(second / "data")) for path in (second / "data").glob("[a-z]*/*")}
    assert not [
        path for path in fetched if path.startswith(("sample", "ingest", "perception", "clouds", "graphs/lidar"))
    ]
    best = f"data/train/{MODEL}/best.pt"
    assert (second / best).read_bytes() == (first / best).read_bytes()
