"""The complete chain as a user runs it, by `dvc repro` in a scratch copy of the project."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from dvc.repo import Repo
from dvc.utils.serialize import modify_yaml

from pipeline.base.resume import ROOT
from tests.kitti_drive import contents
from tests.test_docs import code_block

pytestmark = pytest.mark.slow
MODEL = "sa-gnn-ncp"
NETWORK = [f"train@{MODEL}", f"evaluate@{MODEL}"]
STAGES = (
    "sample",
    "ingest",
    "encoder",
    "perception",
    "motion",
    "labels",
    "scores",
    "clouds",
    "graphs",
    "train",
    "evaluate",
    "report",
)


def run(folder: Path, *command: str, fails: bool = False) -> str:
    """Run a command in a scratch copy, with this environment on the copy's code, and return its
    output.
    """
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    variables = {"PATH": path, "DVC_NO_ANALYTICS": "1", "PYTHONPATH": str(folder)}
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    output = done.stdout + done.stderr
    assert (done.returncode != 0) == fails, output
    return output


def commit(folder: Path) -> None:
    run(folder, "git", "add", "-A")
    run(
        folder,
        "git",
        "-c",
        "user.name=test",
        "-c",
        "user.email=test@example.org",
        "commit",
        "-qm",
        "scratch",
    )


def edit_params(folder: Path, **sections: Any) -> None:
    """Replace sections of a scratch copy's params.yaml, in the format of DVC's own edits."""
    with modify_yaml(str(folder / "params.yaml")) as params:
        params.update(sections)


def stages_run(output: str) -> list[str]:
    """Return the stages that DVC ran, without those that it restored from its cache."""
    return [line.split("'")[1] for line in output.splitlines() if line.startswith("Running stage")]


def outputs(folder: Path) -> dict[str, dict[str, bytes]]:
    """Return stage → relative path → contents of its outputs."""
    return {stage: contents(folder / "data" / stage) for stage in STAGES}


@pytest.fixture(scope="module")
def chain(tmp_path_factory) -> Path:
    """A chain of four short drives that has run to its end, in a repository of its own; its output
    is chain.log.
    """
    folder = tmp_path_factory.mktemp("chain") / "chain"
    for name in run(ROOT, "git", "ls-files", "-co", "--exclude-standard").split():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, folder / name)
    run(folder, "git", "init", "-q")
    params = yaml.safe_load((folder / "params.yaml").read_text())
    drives = {"train": ["2026_01_01_drive_0001..0002"], "val": ["2026_01_02_drive_0001"]}
    edit_params(
        folder,
        sample=params["sample"]
        | {"image_size": [64, 208], "frames": {"train": 24, "val": 14, "test": 20}},
        ingest=params["ingest"]
        | {
            "image_size": [64, 208],
            "lidar": True,
            "drives": drives | {"test": ["2026_01_03_drive_0001"]},
        },
        encoder=params["encoder"] | {"weights": None, "epochs": 2, "frames": 24},
        clouds=params["clouds"] | {"max_points": 3000},
        graphs={
            "semantic": params["graphs"]["semantic"] | {"points": 200},
            "lidar": {"source": "clouds/lidar", "points": 200, "k": 6},
        },
        models={MODEL: params["models"][MODEL]},
        train=params["train"] | {"epochs": 3, "seeds": [0]},
        evaluate=params["evaluate"] | {"bootstrap_samples": 200},
    )
    commit(folder)
    (folder / "chain.log").write_text(run(folder, "dvc", "repro"))
    commit(folder)
    return folder


@pytest.fixture
def folder(chain, tmp_path) -> Path:
    """A copy of the chain with its data, DVC's cache and its history."""
    return Path(shutil.copytree(chain, tmp_path / "copy", symlinks=True))


def test_every_stage_runs_once_in_order_and_the_table_has_its_numbers(chain):
    ran = [name.split("@")[0] for name in stages_run((chain / "chain.log").read_text())]
    assert ran.count("graphs") == 2
    assert tuple(name for name in dict.fromkeys(ran) if name in STAGES) == STAGES
    table = (chain / "data/report/table.md").read_text()
    nmse = json.loads((chain / f"data/evaluate/{MODEL}/metrics.json").read_text())["test"][
        "steering_rad"
    ]["nmse"]
    accuracy = json.loads((chain / "data/scores/metrics.json").read_text())["test"]["classes"][
        "pixel_accuracy"
    ]
    assert any(f"{nmse:.3f}" in row for row in table.splitlines() if row.startswith(f"| {MODEL}"))
    assert f"{accuracy:.3f}" in table


def test_the_python_lines_of_the_readme_give_the_numbers_of_evaluate(chain, monkeypatch):
    monkeypatch.chdir(chain)
    drive, names = "2026_01_03_drive_0001", dict[str, Any]()
    snippet = code_block("trained.load_model(").removeprefix("python\n")
    assert len([line for line in snippet.splitlines() if line]) <= 6
    exec(re.sub(r"\d{4}_\d\d_\d\d_drive_\d{4}", drive, snippet), names)
    table = pd.read_csv(f"data/evaluate/{MODEL}/predictions.csv")
    expected = table[table["drive"] == drive]["predicted_steering_rad"]
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(names["steering_rad"], expected, atol=1e-6)


EDITS: list[tuple[str, set[str]]] = [  # a file or a setting, and the stages that run again
    ("pipeline/train/__pycache__/fit.cpython-311.pyc", set()),  # what an editor or Python leaves
    ("stages/labels.py~", set()),
    ("train.epochs", {"check", NETWORK[0]}),
    ("models/steering/spatial/gnn.py", {"check", *NETWORK}),
    ("models/steering/spatial/polar.py", {"check"}),
]


def test_an_edit_reruns_what_dvc_yaml_promises(folder, monkeypatch):
    """The stages with changed deps or params; DVC runs those after them only if their inputs
    differ.
    """
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
            edit_params(folder, **{section: params[section] | {key: params[section][key] + 1}})
        with Repo() as repo:
            assert set(repo.status()) == expected, name
        path.write_bytes(before) if before else path.unlink()


def test_faults_are_one_line_and_leave_all_outputs(chain, folder):
    def check_refused(output: str, *parts: str) -> None:
        (line,) = (line for line in output.splitlines() if line.startswith("error: "))
        assert all(part in line for part in parts), line
        assert "Traceback" not in output

    params = (folder / "params.yaml").read_text()
    (folder / "params.yaml").write_text(params.replace("input: semantic", "input: semantc"))
    check_refused(run(folder, "dvc", "repro", fails=True), f"models.{MODEL}: input", "semantc")
    (folder / "params.yaml").write_text(params)
    scan = sorted(
        (
            folder / "data/sample/2026_01_01/2026_01_01_drive_0001_sync/velodyne_points/data"
        ).iterdir()
    )[3]
    content = scan.read_bytes()
    scan.write_bytes(content[:-7])
    output = run(folder, "dvc", "repro", "ingest", "--single-item", fails=True)
    check_refused(output, "drive_0001_sync/velodyne_points", scan.name)
    scan.write_bytes(content)
    assert outputs(folder) == outputs(chain)


def test_bytes_do_not_depend_on_workers(chain, folder):
    """The chain ran with one."""
    stages = {"sample": 3, "ingest": 2, "perception": 2, "clouds": 3, "graphs semantic": 2}
    for stage, number in stages.items():
        run(folder, "env", f"STEER_WORKERS={number}", "python", "-m", *f"stages.{stage}".split())
    assert outputs(folder) == outputs(chain)


def test_a_new_drive_costs_one_drive_per_stage(folder):
    ingest = yaml.safe_load((folder / "params.yaml").read_text())["ingest"]
    ingest["drives"]["val"] = ["2026_01_02_drive_0001..0002"]
    edit_params(folder, ingest=ingest)
    # DVC starts each stage, which keeps its drives
    for name in ("camera/geometry.py", "base/console.py"):
        path = folder / "pipeline" / name
        path.write_text(path.read_text().replace('"""', '"""An edited docstring: ', 1))
    output = run(folder, "dvc", "repro", "graphs", "labels", "scores")
    ran = [stage for stage in stages_run(output) if stage != "check"]
    assert {stage.split("@")[0] for stage in ran} == {*STAGES[:9]}
    kept = re.findall(r"(\d+) of (\d+) drives kept from earlier runs", output)
    # The encoder is fitted once. Stage clouds makes drives of images and of scans; scores has no
    # training drives.
    assert sorted(kept) == [("1", "1"), ("2", "3"), *[("4", "5")] * (len(ran) - 1)]


def test_the_first_and_the_last_row_of_preset_kitti_train(folder):
    """On three drives in KITTI's layout, with fewer points and epochs."""
    shutil.copyfile(ROOT / "params.yaml", folder / "params.yaml")
    commit(folder)
    params = yaml.safe_load((folder / "params.yaml").read_text())
    drives = {
        "train": ["2026_01_01_drive_0001"],
        "val": ["2026_01_01_drive_0002"],
        "test": ["2026_01_03_drive_0001"],
    }
    edit_params(folder, ingest=params["ingest"] | {"drives": drives, "lidar": True})
    run(folder, "python", "-m", "stages.sample", "--out", "data/raw")
    run(folder, "git", "checkout", "params.yaml")
    run(folder, "python", "-m", "pipeline.check.preset", "kitti")  # make params PRESET=kitti
    kitti, rows = (
        yaml.safe_load((folder / "params.yaml").read_text()),
        ("cnn-ncp", "motion-10-blind"),
    )
    edit_params(
        folder,
        ingest=kitti["ingest"] | {"image_size": [96, 320], "drives": drives},
        encoder=params["encoder"],
        graphs={
            name: variant | {"points": 400}
            for name, variant in kitti["graphs"].items()
            if name != "image"
        }
        | {"image": kitti["graphs"]["image"]},
        models={name: kitti["models"][name] for name in rows},
        train=kitti["train"] | {"epochs": 2},
    )
    run(folder, "dvc", "repro")
    for name in rows:
        metrics = json.loads((folder / f"data/evaluate/{name}/metrics.json").read_text())
        assert np.isfinite(metrics["test"]["steering_rad"]["nmse"])


def test_a_network_is_added_by_a_file_and_trained_alone(folder):
    network = code_block("class Height(nn.Module)").removeprefix("python\n")
    (folder / "models/steering/spatial/height.py").write_text(network)
    models = yaml.safe_load((folder / "params.yaml").read_text())["models"]
    mine = {
        "input": "semantic",
        "spatial": "height",
        "temporal": "lstm",
        "window": 4,
        "semantics": 1.0,
    }
    edit_params(folder, models=models | {"mine": mine})
    ran = stages_run(run(folder, "dvc", "repro", "train@mine", "evaluate@mine"))
    assert ran == ["train@mine", "evaluate@mine"]


def test_a_second_machine_trains_the_same_network_on_the_firsts_graphs(folder, tmp_path):
    second = tmp_path / "second"
    content = yaml.safe_load((folder / "dvc.lock").read_text())
    for name in (*NETWORK, "report"):  # all but the model is shared
        del content["stages"][name]
    (folder / "dvc.lock").write_text(yaml.safe_dump(content))
    run(folder, "sh", "-c", f"dvc remote add -d lab {tmp_path}/folder && dvc push")
    commit(folder)
    run(tmp_path, "git", "clone", "-q", str(folder), str(second))
    command = f"dvc repro --pull --downstream train@{MODEL}"
    assert code_block(command)
    assert stages_run(run(second, *command.split())) == [*NETWORK, "report"]
    fetched = {
        str(path.relative_to(second / "data")) for path in (second / "data").glob("[a-z]*/*")
    }
    unused = ("sample", "ingest", "perception", "clouds", "graphs/lidar")
    assert not [path for path in fetched if path.startswith(unused)]
    best = f"data/train/{MODEL}/best.pt"
    assert (second / best).read_bytes() == (folder / best).read_bytes()
