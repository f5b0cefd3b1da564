"""The chain of stages is that of DVC's own lock, and its hashes are DVC's own."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from pipeline.base.errors import InputError
from pipeline.inspect import lineage, stages_due, words

PIPELINE = """
stages:
  ingest:
    cmd: mkdir -p data/ingest && cp code/ingest/a.py data/ingest/
    deps: [code/ingest]
    params: [ingest]
    outs: [data/ingest]
  labels:
    cmd: mkdir -p data/labels && cp data/ingest/a.py data/labels/
    deps: [data/ingest, code/labels.py]
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
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project that ran to its end."""
    folder = tmp_path_factory.mktemp("made")
    files = {
        "dvc.yaml": PIPELINE, "params.yaml": PARAMS, "code/ingest/a.py": "a\n", "code/ingest/deep/b.py": "b\n",
        "code/ingest/c.pyc": "left by Python", "code/labels.py": "labels\n", ".dvcignore": "*.py[co]\n",
    }  # fmt: skip
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    dvc(folder, "init", "--no-scm", "--quiet")
    dvc(folder, "repro", "--quiet")
    return folder


@pytest.fixture
def project(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "project")
    return tmp_path / "project"


def stages(path: Path) -> dict[str, dict[str, Any]]:
    return {stage["name"]: stage for stage in lineage.chain(path)["stages"]}


@pytest.mark.slow
def test_the_chain_goes_back_to_the_first_stage_and_nothing_has_changed(project: Path) -> None:
    chain = stages(project / "data/train/small/labels/a.py")
    assert list(chain) == ["train@small", "labels", "ingest"]
    assert chain["ingest"]["cmd"].startswith("mkdir -p data/ingest")
    assert chain["ingest"]["settings"] == {"ingest": {"size": [1, 2]}}
    assert chain["labels"]["inputs"] == {"data/ingest": chain["ingest"]["outputs"]["data/ingest"]}
    assert chain["ingest"]["code"] == {"code/ingest": "same"}
    assert chain["labels"]["code"] == {"code/labels.py": "same"}
    assert all(not stage["settings_now"] and not stage["remade"] for stage in chain.values())
    assert list(stages(project / "data/train")) == ["train@large", "train@small", "labels", "ingest"]


@pytest.mark.slow
def test_what_dvc_ignores_changes_nothing_and_an_edit_does(project: Path) -> None:
    (project / "code/ingest/d.pyc").write_text("another")
    assert stages(project / "data/labels")["ingest"]["code"] == {"code/ingest": "same"}
    (project / "code/ingest/deep/b.py").write_text("edited")
    (project / "code/labels.py").unlink()
    (project / "params.yaml").write_text(PARAMS.replace("2.7", "2.9"))
    chain = lineage.chain(project / "data/labels")
    told = {stage["name"]: stage for stage in chain["stages"]}
    assert told["ingest"]["code"] == {"code/ingest": "changed"}
    assert told["labels"]["code"] == {"code/labels.py": "missing"}
    assert told["labels"]["settings_now"] == {"labels.wheelbase_m": 2.9}
    text = "\n".join(words.provenance(chain, []))
    assert "changed since it was made: code/ingest (changed)" in text
    assert "params.yaml says otherwise now: labels.wheelbase_m: 2.9" in text


@pytest.mark.slow
def test_an_input_that_was_made_again_is_told_and_so_is_an_output_that_was_written_since(project: Path) -> None:
    (project / "code/ingest/a.py").write_text("another\n")
    dvc(project, "repro", "--quiet", "ingest")
    chain = lineage.chain(project / "data/labels")
    assert chain["stages"][0]["remade"] == ["data/ingest"]
    assert chain["altered"] == []
    with (project / "data/labels/a.py").open("a") as file:
        file.write("more")
    chain = lineage.chain(project / "data/labels")
    assert chain["altered"] == ["data/labels"]
    text = "\n".join(words.provenance(chain, []))
    assert "MADE AGAIN SINCE" in text
    assert "data/labels has other sizes than dvc.lock says" in text


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:_NoneStep:DeprecationWarning")  # DVC's own, in pygtrie
def test_stages_are_due_with_what_follows_them_in_the_order_of_the_run(project: Path) -> None:
    assert stages_due.due(project) == {}
    (project / "code/labels.py").write_text("edited")
    due = stages_due.due(project)
    assert next(iter(due)) == "labels"
    assert due["labels"] == "changed deps: code/labels.py"
    assert {name: due[name] for name in due if name != "labels"} == dict.fromkeys(
        ("train@small", "train@large"), "follows labels"
    )
    (project / "dvc.lock").unlink()
    assert set(stages_due.due(project).values()) == {"it has not run here"}
    (project / "dvc.yaml").write_text("stages: [")
    with pytest.raises(InputError, match="DVC cannot say which stage has to run"):
        stages_due.due(project)


def test_without_a_lock_nothing_is_claimed(tmp_path: Path) -> None:
    (tmp_path / "data/labels").mkdir(parents=True)
    assert "no dvc.lock" in lineage.chain(tmp_path / "data/labels")["why"]
    (tmp_path / "dvc.yaml").write_text(PIPELINE)
    assert "no dvc repro ended here" in lineage.chain(tmp_path / "data/labels")["why"]
    (tmp_path / "dvc.lock").write_text("stages: {ingest: {outs: [{path: data/ingest}]}}")
    chain = lineage.chain(tmp_path / "data/labels")
    assert "knows no stage that made this" in chain["why"]
    assert any("not known stage by stage" in line for line in words.provenance(chain, []))


@pytest.mark.parametrize(
    "content",
    ["", "[]", "null", "stages: 3", "stages: {a: 3}", "[" * 100_000, "a: [", "stages: &a {b: *a}", "\x00", "a: !!x b"],
)
def test_a_damaged_lock_is_one_line(tmp_path: Path, content: str) -> None:
    (tmp_path / "dvc.lock").write_text(content)
    with pytest.raises(InputError, match=r"dvc\.lock is damaged"):
        lineage.chain(tmp_path / "data")


def test_a_lock_of_another_shape_and_damaged_params_are_told_as_far_as_they_go(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "dvc.lock").write_text(
        "stages: {a: {outs: [{path: data}, 3], deps: [{path: ../up}, {path: 3}], params: {x: 4}}, b: {outs: 3}}"
    )
    (tmp_path / "params.yaml").write_text("a: &a [1]\nb: *a\n")
    chain = lineage.chain(tmp_path / "data")
    assert [stage["name"] for stage in chain["stages"]] == ["a"]
    assert "aliases" in chain["unread"]
    assert any("not compared" in line for line in words.provenance(chain, []))
