"""What ``make PRESET`` prepares; in place of DVC stands a command that notes how it was called."""

import fcntl
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from pipeline.base.resume import ROOT
from pipeline.sections import preset

DVC = """#!/bin/sh
echo "$@" >> {log}
case "$1" in
init) mkdir .dvc ;;
repro)
  mkdir -p data/report/settings && touch data/report/index.html
  echo "| of $(basename "$PWD") |" | tee data/report/table.csv > data/report/table.md
  case "$PWD" in */studies) touch data/report/settings/studies.md data/report/settings/roads.png ;; esac ;;
esac
"""

PYTHON = """#!/bin/sh
exec "{python}" "$@"
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A copy of the project; its python is this one, and its dvc only pretends."""
    folder = tmp_path / "checkout"
    ignore = shutil.ignore_patterns("__pycache__")
    for room in ("pipeline", "models", "stages", "presets"):
        shutil.copytree(ROOT / room, folder / room, ignore=ignore)
    for name in ("Makefile", "params.yaml", "dvc.yaml", ".dvcignore", "data/.gitignore"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copyfile(ROOT / name, folder / name)
    (folder / "fake/bin").mkdir(parents=True)
    for name, text in {"python": PYTHON, "dvc": DVC}.items():
        (folder / "fake/bin" / name).write_text(text.format(log=folder / "calls", python=sys.executable))
        (folder / "fake/bin" / name).chmod(0o755)
    return folder


def make(checkout: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run make without its target `setup`, which would install."""
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "MAKEFLAGS")}
    command = ["make", "-o", "setup", "VENV=fake", *words]
    return subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_presets_run_in_copies_of_the_code_and_leave_ones_own_files_alone(checkout: Path) -> None:
    own = (checkout / "params.yaml").read_text()
    for name in ("kitti", "table2"):
        made = make(checkout, name)
        assert made.returncode == 0, made.stderr
        run = checkout / "runs" / name
        assert yaml.safe_load((run / "params.yaml").read_text()) == preset.merged(name)
        for copied in ("dvc.yaml", ".dvcignore", "data/.gitignore", "stages/check.py", "pipeline/label.py"):
            assert (run / copied).read_bytes() == (ROOT / copied).read_bytes()
        assert (run / "data/raw").resolve() == checkout / "data/raw"
        assert (run / "weights").resolve() == checkout / "weights"
        assert (checkout / f"data/report/{name}.md").read_text() == f"| of {name} |\n"
        assert all((checkout / f"data/report/{name}.{kind}").is_file() for kind in ("csv", "html"))
    assert (checkout / "params.yaml").read_text() == own
    assert sorted(path.name for path in (checkout / "data").iterdir()) == [".gitignore", "report"]
    (checkout / "runs/kitti/pipeline/gone.py").touch()
    make(checkout, "kitti")
    assert not (checkout / "runs/kitti/pipeline/gone.py").exists()
    first = ["init --quiet --no-scm", "cache dir ../../.dvc/cache", "repro"]
    assert (checkout / "calls").read_text().splitlines() == [*first, *first, *first[1:]]


@pytest.mark.slow
def test_a_second_run_of_a_preset_touches_nothing_under_the_first(checkout: Path) -> None:
    (checkout / "runs/kitti/stages").mkdir(parents=True)
    (checkout / "runs/kitti/stages/check.py").write_text("# of the run at work\n")
    with (checkout / "runs/kitti.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        refused = make(checkout, "kitti")
        assert refused.returncode != 0
        assert "error: another make kitti is at work in runs/kitti: wait for it to end\n" in refused.stderr
        assert make(checkout, "table2").returncode == 0
        assert (checkout / "runs/kitti/stages/check.py").read_text() == "# of the run at work\n"
        assert [path.name for path in (checkout / "runs/kitti").iterdir()] == ["stages"]
    assert make(checkout, "kitti").returncode == 0
    (checkout / "fake/bin/dvc").write_text("#!/bin/sh\nexit 3\n")
    failed = make(checkout, "kitti")
    assert failed.returncode != 0
    assert "another make" not in failed.stderr


@pytest.mark.slow
def test_what_studies_draw_is_brought_here(checkout: Path) -> None:
    for name in ("table2", "studies", "studies"):
        made = make(checkout, name)
        assert made.returncode == 0, made.stderr
    folders = {path.name: path for path in (checkout / "data/report").iterdir() if path.is_dir()}
    assert list(folders) == ["studies"]
    assert sorted(path.name for path in folders["studies"].iterdir()) == ["roads.png", "studies.md"]


@pytest.mark.slow
def test_a_preset_is_written_over_params_yaml(checkout: Path) -> None:
    asked = make(checkout, "params")
    assert asked.returncode != 0
    assert " ".join(sorted(path.stem for path in preset.PRESETS.glob("*.yaml"))) in asked.stderr
    (checkout / "mine.yaml").write_text("train: {epochs: 3}\n")
    made = make(checkout, "params", "PRESET=mine.yaml")
    assert "mine.yaml" in made.stdout, made.stderr
    assert yaml.safe_load((checkout / "params.yaml").read_text())["train"]["epochs"] == 3
    refused = make(checkout, "params", "PRESET=kiti")
    assert refused.returncode != 0
    assert "kitti" in refused.stderr
