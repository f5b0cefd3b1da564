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

from pipeline.base.checkout import ROOT
from tests.kitti_drive import contents
from tests.test_docs import code_block

pytestmark = pytest.mark.slow
MODEL = "sa-gnn-ncp"
NETWORK = [f"train@{MODEL}", f"evaluate@{MODEL}"]
STAGES = ("sample", "ingest", "labels", "encoder", "perception", "motion", "scores", "clouds")
STAGES += ("graphs", "train", "evaluate", "report")


def run(folder: Path, *command: str, fails: bool = False) -> str:
    """Run a command in a scratch copy, with the copy's code, and return its output."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    variables = {"PATH": path, "DVC_NO_ANALYTICS": "1", "PYTHONPATH": str(folder)}
    environment = {**os.environ, **variables}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    output = done.stdout + done.stderr
    assert (done.returncode != 0) == fails, output
    return output


def commit(folder: Path) -> None:
    author = "-c user.name=test -c user.email=test@example.org"
    run(folder, "git", "add", "-A")
    run(folder, *f"git {author} commit -qm scratch".split())


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
    """Run the chain of four short drives in a new repository; its output is chain.log."""
    folder = tmp_path_factory.mktemp("chain") / "chain"
    for name in run(ROOT, "git", "ls-files", "-co", "--exclude-standard").split():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, folder / name)
    run(folder, "git", "init", "-q")
    params = yaml.safe_load((folder / "params.yaml").read_text())
    drives = {
        "train": ["2026_01_01_drive_0001..0002"],
        "val": ["2026_01_02_drive_0001"],
        "test": ["2026_01_03_drive_0001"],
    }
    frames = {"train": 24, "val": 14, "test": 20}
    params["sample"] |= {"image_size": [64, 208], "frames": frames}
    params["ingest"] |= {"image_size": [64, 208], "lidar": True, "drives": drives}
    params["encoder"] |= {"weights": None, "epochs": 2, "frames": 24}
    params["clouds"] |= {"max_points": 3000}
    params["graphs"] = {
        "semantic": params["graphs"]["semantic"] | {"points": 200},
        "lidar": {"source": "clouds/lidar", "points": 200, "k": 6},
    }
    params["models"] = {MODEL: params["models"][MODEL]}
    params["train"] |= {"epochs": 3, "seeds": [0]}
    params["evaluate"] |= {"bootstrap_samples": 200}
    edit_params(folder, **params)
    commit(folder)
    (folder / "chain.log").write_text(run(folder, "dvc", "repro"))
    commit(folder)
    return folder


@pytest.fixture
def folder(chain, tmp_path) -> Path:
    """Return a copy of the chain with its data, DVC's cache and its history."""
    return Path(shutil.copytree(chain, tmp_path / "copy", symlinks=True))


def test_every_stage_runs_once_in_order_and_the_table_has_its_numbers(chain):
    ran = [name.split("@")[0] for name in stages_run((chain / "chain.log").read_text())]
    assert ran.count("graphs") == 2
    ran.remove("check")
    assert tuple(dict.fromkeys(ran)) == STAGES

    table = (chain / "data/report/table.md").read_text()
    metrics = json.loads((chain / f"data/evaluate/{MODEL}/metrics.json").read_text())
    assert f"{metrics['test'][MODEL]['nmse']:.3f}" in table
    scores = json.loads((chain / "data/scores/metrics.json").read_text())
    assert f"{scores['test']['classes']['pixel_accuracy']:.3g}" in table


def test_the_python_lines_of_the_readme_give_the_numbers_of_evaluate(chain, monkeypatch):
    monkeypatch.chdir(chain)
    drive = "2026_01_03_drive_0001"
    names = dict[str, Any]()
    snippet = code_block("trained.load_model(").removeprefix("python\n")
    exec(re.sub(r"\d{4}_\d\d_\d\d_drive_\d{4}", drive, snippet), names)
    table = pd.read_csv(f"data/evaluate/{MODEL}/predictions.csv")
    expected = table[table["drive"] == drive]["predicted_steering_rad"]
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(names["steering_rad"], expected, atol=1e-6)


def test_an_edit_reruns_what_dvc_yaml_promises(folder, monkeypatch):
    """Only stages with changed deps or params run; later ones if their inputs differ then."""
    monkeypatch.chdir(folder)  # DVC names stages relative to it

    def reruns() -> set[str]:
        with Repo() as repo:
            return set(repo.status())

    (folder / "stages/labels.py~").write_text("a copy that an editor leaves")
    assert reruns() == set()

    for name, stages in (
        ("models/steering/spatial/gnn.py", {"check", *NETWORK}),
        ("models/steering/spatial/pyg.py", {"check"}),
        ("pipeline/jobs/runner.py", {"check"}),
        ("pipeline/motion/speed.py", {"check", "motion"}),
        (
            "pipeline/clouds/cloud_file.py",
            {"check", "clouds", "graphs@semantic", "graphs@lidar", "report"},
        ),
        ("pipeline/labels/label_file.py", {"check", "labels", "scores", *NETWORK, "report"}),
    ):
        path = folder / name
        text = path.read_text()
        path.write_text(f"{text}\n# an edit\n")
        assert reruns() == stages, name
        path.write_text(text)

    params = yaml.safe_load((folder / "params.yaml").read_text())
    edit_params(folder, train=params["train"] | {"epochs": params["train"]["epochs"] + 1})
    assert reruns() == {"check", NETWORK[0]}


def test_a_fault_is_one_line_and_leaves_all_outputs(chain, folder):
    drive = folder / "data/sample/2026_01_01/2026_01_01_drive_0001_sync"
    scan = sorted((drive / "velodyne_points/data").iterdir())[3]
    content = scan.read_bytes()
    scan.write_bytes(content[:-7])
    output = run(folder, "dvc", "repro", "ingest", "--single-item", fails=True)
    (error,) = [line for line in output.splitlines() if line.startswith("error: ")]
    assert scan.name in error
    assert "Traceback" not in output
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
    # DVC starts each stage, which keeps its drives.
    output = run(folder, "dvc", "repro", "--force", "graphs", "labels", "scores")
    ran = [stage for stage in stages_run(output) if stage != "check"]
    assert {stage.split("@")[0] for stage in ran} == {*STAGES[:9]}
    kept = re.findall(r"(\d+) of (\d+) drives kept from earlier runs", output)
    # The encoder is fitted once. Stage clouds makes drives of images and of scans; scores has no
    # training drives.
    assert sorted(kept) == [("1", "1"), ("2", "3"), *[("4", "5")] * (len(ran) - 1)]


def test_a_network_is_added_by_a_file_and_trained_alone(folder):
    network = code_block("class Height(nn.Module)").removeprefix("python\n")
    (folder / "models/steering/spatial/height.py").write_text(network)
    network = code_block("class GRU(RecurrentCell)").removeprefix("python\n")
    (folder / "models/steering/temporal/gru.py").write_text(network)
    models = yaml.safe_load((folder / "params.yaml").read_text())["models"]
    models["mine"] = {
        "input": "semantic",
        "spatial": "height",
        "temporal": "gru",
        "semantics": 1.0,
    }
    edit_params(folder, models=models)
    ran = stages_run(run(folder, "dvc", "repro", "train@mine", "evaluate@mine"))
    assert ran == ["train@mine", "evaluate@mine"]


@pytest.fixture
def second(folder, tmp_path) -> Path:
    """Return the folder of a second machine. The first one, `folder`, gets a remote."""
    run(folder, "dvc", "remote", "add", "-d", "lab", str(tmp_path / "lab"))
    return tmp_path / "second"


def test_a_second_machine_trains_the_same_network_on_the_firsts_graphs(folder, second):
    content = yaml.safe_load((folder / "dvc.lock").read_text())
    for name in (*NETWORK, "report"):  # all but the model is shared
        del content["stages"][name]
    (folder / "dvc.lock").write_text(yaml.safe_dump(content))
    run(folder, "dvc", "push")
    commit(folder)
    run(folder, "git", "clone", "-q", ".", str(second))
    command = f"dvc repro --pull --downstream train@{MODEL}"
    assert code_block(command)
    assert stages_run(run(second, *command.split())) == [*NETWORK, "report"]
    for unused in ("sample", "ingest", "perception", "clouds", "graphs/lidar"):
        assert not any((second / "data" / unused).glob("*")), unused
    best = f"data/train/{MODEL}/best.pt"
    assert (second / best).read_bytes() == (folder / best).read_bytes()


def test_a_second_machine_reads_shared_clouds_and_makes_other_graphs(folder, second, monkeypatch):
    """By the commands of docs/running.md and the code of data/README.md."""
    push = "dvc push clouds motion labels"
    pull = "dvc pull clouds motion labels"
    make = "dvc repro --single-item graphs@dense"
    assert push in code_block("dvc remote add")
    assert pull in code_block(make)
    run(folder, *push.split())
    commit(folder)
    run(folder, "git", "clone", "-q", ".", str(second))
    run(second, *pull.split())
    graphs = yaml.safe_load((second / "params.yaml").read_text())["graphs"]
    graphs["dense"] = {"source": "clouds/pseudo", "points": 50, "k": 10}
    edit_params(second, graphs=graphs)
    assert stages_run(run(second, *make.split())) == ["graphs@dense"]

    drives = json.loads((second / "data/clouds/pseudo/index.json").read_text())["drives"]
    lines = code_block("np.intersect1d").removeprefix("python\n")
    names: dict[str, Any] = {}
    monkeypatch.chdir(second)
    exec(lines.replace("2026_06_01_drive_0004", next(iter(drives))), names)
    assert names["xyz"].shape == (len(names["cls"]), 3)
    assert np.isfinite(names["steering_rad"])
