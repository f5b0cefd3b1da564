"""Origin of an artefact by dvc.lock, and the stages that DVC would run."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.show import project

PIPELINE = """
stages:
  ingest:
    cmd: mkdir -p data/ingest && cp code.py data/ingest/
    deps: [code.py]
    params: [ingest]
    outs: [data/ingest]
  labels:
    cmd: mkdir -p data/labels && cp data/ingest/code.py data/labels/
    deps: [data/ingest, labels.py]
    params: [labels.wheelbase_m]
    outs: [data/labels]
  train:
    foreach: {small: 1, large: 2}
    do:
      cmd: mkdir -p data/train/${key} && cp -r data/labels data/train/${key}/
      deps: [data/labels]
      outs: ["data/train/${key}"]
"""
PARAMS = "ingest: {size: [1, 2]}\nlabels: {wheelbase_m: 2.7}\n"


def dvc(folder: Path, *command: str) -> None:
    environment = {**os.environ, "DVC_NO_ANALYTICS": "1"}
    subprocess.run(
        [sys.executable, "-m", "dvc", *command], cwd=folder, env=environment, check=True, capture_output=True
    )


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project in which all stages ran."""
    folder = tmp_path_factory.mktemp("finished")
    files = {"dvc.yaml": PIPELINE, "params.yaml": PARAMS, "code.py": "a\n", "labels.py": "labels\n"}
    for name, content in files.items():
        (folder / name).write_text(content)
    dvc(folder, "init", "--no-scm", "--quiet")
    dvc(folder, "repro", "--quiet")
    return folder


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    shutil.copytree(finished, tmp_path / "project")
    return tmp_path / "project"


@pytest.mark.slow
def test_stage_and_its_inputs(finished: Path) -> None:
    assert project.trace(finished / "data/train/small/labels/code.py") == {
        "written by": "train@small", "inputs": "data/labels",
    }  # fmt: skip
    assert set(project.trace(finished / "data/train")["written by"].split(", ")) == {"train@large", "train@small"}
    assert "no stage" in project.trace(finished / "labels.py")["written by"]


@pytest.mark.slow
def test_due_stages_in_the_order_of_the_run(copy: Path) -> None:
    assert project.due_stages(copy) == {}
    (copy / "labels.py").write_text("edited")
    due = project.due_stages(copy)
    assert next(iter(due.items())) == ("labels", "changed deps: labels.py")
    assert {due[name] for name in due if name != "labels"} == {"needs labels"}
    (copy / "dvc.lock").unlink()
    assert set(project.due_stages(copy).values()) == {"has not run here"}
    (copy / "dvc.yaml").write_text("stages: [")
    with pytest.raises(InputError, match="dvc status failed"):
        project.due_stages(copy)


def test_a_running_writer_is_found_behind_dead_ones(tmp_path: Path) -> None:
    with subprocess.Popen(["true"]) as ended:
        pass
    lock = tmp_path / ".dvc/tmp/rwlock"
    lock.parent.mkdir(parents=True)

    def running(*processes: int) -> str:
        writers = {f"data/{number}": {"pid": pid, "cmd": f"repro {pid}"} for number, pid in enumerate(processes)}
        lock.write_text(json.dumps({"write": writers, "read": {}}))
        return project.running_command(tmp_path)

    assert running(ended.pid) == ""
    assert running(ended.pid, 10**30, os.getpid()) == f"repro {os.getpid()}"
    lock.write_text("{")
    assert project.running_command(tmp_path) == ""


def test_a_process_of_another_user_is_running(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(process: int, signal: int) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "kill", refuse)
    (tmp_path / ".dvc/tmp").mkdir(parents=True)
    (tmp_path / ".dvc/tmp/rwlock").write_text('{"write": {"data": {"pid": 1, "cmd": "repro"}}}')
    assert project.running_command(tmp_path) == "repro"
