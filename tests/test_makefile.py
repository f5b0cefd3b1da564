"""Test the Makefile: presets with a DVC that only logs its calls, and set-up with a uv and a pip that do the same."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from pipeline.base.resume import ROOT
from pipeline.settings import preset

DVC = """#!/bin/sh
echo "$@" >> {log}
case "$1" in
init) mkdir .dvc ;;
repro)
  mkdir -p data/report && touch data/report/index.html
  echo "| $(basename "$PWD") |" | tee data/report/table.csv > data/report/table.md ;;
esac
"""
PYTHON = """#!/bin/sh
case "$*" in
*"pip install"*) echo "pip $@" >> {log} ;;
*"config list"*)
  printf "%s\\n" "global.extra-index-url='\\\\nhttps://a\\\\nhttps://b'" "install.find-links='/w1 /w2'" ;;
*) exec "{python}" "$@" ;;
esac
"""
UV = """#!/bin/sh
echo "uv $UV_FIND_LINKS $UV_EXTRA_INDEX_URL" >> {log}
exit {status}
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Return a copy of the project with this python and a dvc that only logs."""
    folder = tmp_path / "checkout"
    for name in ("pipeline", "models", "stages", "presets"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("Makefile", "params.yaml", "dvc.yaml", ".dvcignore", "data/.gitignore"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copyfile(ROOT / name, folder / name)
    write_programs(folder, python=PYTHON, dvc=DVC)
    return folder


def write_programs(folder: Path, status: int = 0, **programs: str) -> None:
    (folder / "fake/bin").mkdir(parents=True, exist_ok=True)
    for name, text in programs.items():
        path = folder / "fake/bin" / name
        path.write_text(text.format(log=folder / "calls", python=sys.executable, status=status))
        path.chmod(0o755)


def make(checkout: Path, *words: str, skip: str = "setup") -> subprocess.CompletedProcess[str]:
    """Run make without the target `skip`, which would install packages."""
    variables = ("PYTHONPATH", "MAKEFLAGS", "UV_FIND_LINKS", "UV_EXTRA_INDEX_URL")
    environment = {name: value for name, value in os.environ.items() if name not in variables}
    command = ["make", "-o", skip, "VENV=fake", *words]
    return subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("status", [0, 1])
def test_setup_installs_with_uv_and_pips_settings_or_else_with_pip(tmp_path: Path, status: int) -> None:
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copyfile(ROOT / name, tmp_path / name)
    write_programs(tmp_path, status, python=PYTHON, uv=UV)
    for _ in range(2):  # the second finds the marker file
        done = make(tmp_path, "setup", skip="system")
        assert done.returncode == 0, done.stderr
    bootstrap, uv, *pip = (tmp_path / "calls").read_text().splitlines()
    assert bootstrap.endswith("--constraint constraints.txt uv")
    assert uv.split() == ["uv", "/w1,/w2", "https://a", "https://b"]
    assert [line.split()[-3:] for line in pip] == status * [["torch", "--editable", ".[dev]"]]


@pytest.mark.slow
def test_a_preset_runs_in_a_copy_of_the_code(checkout: Path) -> None:
    params = (checkout / "params.yaml").read_text()
    for name in ("kitti", "table2"):
        done = make(checkout, name)
        assert done.returncode == 0, done.stderr
        run = checkout / "runs" / name
        assert yaml.safe_load((run / "params.yaml").read_text()) == preset.merged(name)
        for copied in ("dvc.yaml", ".dvcignore", "data/.gitignore", "stages/check.py", "pipeline/labels/label.py"):
            assert (run / copied).read_bytes() == (ROOT / copied).read_bytes()
        assert (run / "data/raw").resolve() == checkout / "data/raw"
        assert (run / "weights").resolve() == checkout / "weights"
        assert (checkout / f"data/report/{name}.md").read_text() == f"| {name} |\n"
        assert all((checkout / f"data/report/{name}.{kind}").is_file() for kind in ("csv", "html"))
    assert (checkout / "params.yaml").read_text() == params
    assert sorted(path.name for path in (checkout / "data").iterdir()) == [".gitignore", "report"]
    (checkout / "runs/kitti/pipeline/removed.py").touch()
    make(checkout, "kitti")
    assert not (checkout / "runs/kitti/pipeline/removed.py").exists()
    first = ["init --quiet --no-scm", "config cache.type hardlink,copy", "cache dir ../../.dvc/cache", "repro"]
    assert (checkout / "calls").read_text().splitlines() == [*first, *first, *first[1:]]


@pytest.mark.slow
def test_the_samples_encoder_is_made_by_one_command(checkout: Path) -> None:
    """With its preset, but small."""
    path = checkout / "presets/encoder.yaml"
    content = yaml.safe_load(path.read_text())
    content["sample"] |= {"image_size": [32, 96], "frames": dict.fromkeys(("train", "val", "test"), 1)}
    content["ingest"] |= {"image_size": [32, 96]}
    content["ingest"]["drives"]["train"] = content["ingest"]["drives"]["train"][0].split("..")[:1]
    content["encoder"] |= {"epochs": 1}
    path.write_text(yaml.safe_dump(content))
    shutil.rmtree(checkout / "models/encoder/sample")
    done = make(checkout, "encoder")
    assert done.returncode == 0, done.stderr
    made = checkout / "models/encoder/sample"
    assert sorted(file.name for file in made.iterdir()) == ["config.json", "encoder.pt"]
    (drive,) = content["ingest"]["drives"]["train"]
    assert json.loads((made / "config.json").read_text())["frames_per_drive"] == {drive: 1}
