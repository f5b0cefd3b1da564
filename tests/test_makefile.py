"""Test the Makefile: presets with a DVC that only logs its calls."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from filelock import FileLock

from pipeline.base.resume import ROOT, revision
from pipeline.check import preset

DVC = """#!/bin/sh
echo "$@" >> {log}
case "$1" in
init) mkdir .dvc ;;
stage) echo train@fails train@works | tr ' ' '\\n' ;;
--wait-for-lock)
  case "$4" in train@fails) echo "$4: loss is nan" >&2; exit 255 ;; esac
  sleep 0.5; echo "trained $4" >> {log} ;;
repro)
  mkdir -p data/report && ls stages > dvc.lock
  echo "<h1>Steering report</h1> Next: <code>dvc exp run</code>" > data/report/index.html
  echo {{}} > data/report/results.json
  echo "| $(basename "$PWD") |" > data/report/table.md ;;
esac
"""
PYTHON = '#!/bin/sh\nexec "{python}" "$@"\n'


@pytest.fixture
def checkout(tmp_path) -> Path:
    """Return a copy of the project with this python and a dvc that only logs."""
    folder = tmp_path / "checkout"
    for name in ("pipeline", "models", "stages", "presets"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("Makefile", "params.yaml", "dvc.yaml", ".dvcignore", "data/.gitignore"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copyfile(ROOT / name, folder / name)
    (folder / "fake/bin").mkdir(parents=True)
    for name, text in {"python": PYTHON, "dvc": DVC}.items():
        path = folder / "fake/bin" / name
        path.write_text(text.format(log=folder / "calls", python=sys.executable))
        path.chmod(0o755)
    return folder


def make(checkout: Path, target: str) -> subprocess.CompletedProcess[str]:
    """Run make without the target setup, which would install packages."""
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "MAKEFLAGS")}
    command = ["make", "-o", "setup", "VENV=fake", target]
    return subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_a_preset_runs_in_a_copy_of_the_code(checkout):
    params = (checkout / "params.yaml").read_text()
    done = make(checkout, "kitti")
    assert done.returncode == 0, done.stderr
    run = checkout / "runs/kitti"
    assert yaml.safe_load((run / "params.yaml").read_text()) == preset.merged("kitti")
    for copied in ("dvc.yaml", ".dvcignore", "data/.gitignore", "stages/check.py", "pipeline/labels/label.py"):
        assert (run / copied).read_bytes() == (ROOT / copied).read_bytes()
    assert (run / "data/raw").resolve() == checkout / "data/raw"
    assert (run / "weights").resolve() == checkout / "weights"
    assert (checkout / "data/report/kitti.md").read_text() == "| kitti |\n"
    page = (checkout / "data/report/kitti.html").read_text()
    assert "<h1>Steering report</h1>\n<details><summary>preset kitti, revision unknown, date 20" in page
    assert "<pre>ingest:\n  source: kitti\n" in page
    assert "Next: <code>$EDITOR presets/kitti.yaml &amp;&amp; make kitti " in page
    assert "\npreset kitti, revision unknown, date 20" in done.stdout
    assert (checkout / "params.yaml").read_text() == params
    first = ["init --quiet --no-scm", "config cache.type hardlink,copy", "cache dir .dvc/cache", "repro"]
    assert (checkout / "calls").read_text().splitlines() == first

    (run / "pipeline/mine.py").write_text("mine")  # a user's file stays, one that the code no longer has goes
    lock = (run / "dvc.lock").read_text()
    make(checkout, "kitti")
    assert not (run / "dvc.lock.before").exists(), "the code is the same"
    (checkout / "stages/labels.py").rename(checkout / "stages/renamed.py")
    make(checkout, "kitti")
    assert (run / "pipeline/mine.py").read_text() == "mine"
    assert not (run / "stages/labels.py").exists()
    assert (run / "dvc.lock.before").read_text() == lock != (run / "dvc.lock").read_text()

    calls = (checkout / "calls").read_text()
    with FileLock(checkout / "runs/kitti.lock"):
        done = make(checkout, "kitti")
    assert done.returncode != 0
    assert "runs/kitti: another process is writing it" in done.stderr
    assert (checkout / "calls").read_text() == calls


@pytest.mark.slow
def test_the_demo_ends_all_trainings_before_it_shows_a_failure(checkout):
    """Without git, as in GitHub's ZIP; DVC's exit status 255 would end xargs at once."""
    done = make(checkout, "demo")
    assert done.returncode != 0
    calls = (checkout / "calls").read_text().splitlines()
    assert (calls[0], calls[-1]) == ("config --local core.no_scm true", "trained train@works")
    assert "train@fails: loss is nan" in done.stderr


def test_a_revision_names_the_commit_and_edits_of_the_code(tmp_path):
    assert revision(tmp_path) == ""
    (tmp_path / "dvc.yaml").write_text("stages: {}")
    for words in ("init -q", "add .", "-c user.name=a -c user.email=a commit -qm a"):
        subprocess.run(["git", *words.split()], cwd=tmp_path, check=True)
    commit = revision(tmp_path)
    assert re.fullmatch("[0-9a-f]{7}", commit)
    (tmp_path / "results.json").touch()
    (tmp_path / "presets").mkdir()
    (tmp_path / "presets/monday.yaml").touch()
    assert revision(tmp_path) == commit
    (tmp_path / "dvc.yaml").write_text("stages: {a: }")
    assert revision(tmp_path) == f"{commit}-dirty"


def test_no_preset_has_the_name_of_a_target():
    text = (ROOT / "Makefile").read_text()
    targets = {*re.findall(r"^([a-z]+):", text, re.MULTILINE), *re.search("CLOSED := (.*)", text)[1].split()}
    assert targets == {*preset.TARGETS}
