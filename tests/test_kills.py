"""The chain, killed, ends with the bytes of a run that nothing disturbed, and does no finished work twice."""

import os
import random
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest
import yaml

from tests import scratch

RWLOCK = ".dvc/tmp/rwlock"  # DVC does not write it in one step
NAMES = {"graphs": "graphs@semantic", "train": f"train@{scratch.MODEL}", "evaluate": f"evaluate@{scratch.MODEL}"}


def forget_from(folder: Path, stage: str) -> None:
    """Delete the outputs of a stage and of all later ones, and what DVC knows of them."""
    later = scratch.STAGES[scratch.STAGES.index(stage) :]
    for name in later:
        shutil.rmtree(folder / "data" / name, ignore_errors=True)
    shutil.rmtree(folder / ".dvc/cache", ignore_errors=True)
    lock = yaml.safe_load((folder / "dvc.lock").read_text())
    lock["stages"] = {name: entry for name, entry in lock["stages"].items() if name.split("@")[0] not in later}
    (folder / "dvc.lock").write_text(yaml.safe_dump(lock, sort_keys=False))


def kill_in(folder: Path, stage: str, after_s: float | None) -> None:
    """Run a stage by DVC and kill it with all its processes, `after_s` seconds after its start or after one drive."""
    log = folder / "killed.log"
    with log.open("w") as output:
        repro = subprocess.Popen(
            ["dvc", "repro", NAMES.get(stage, stage)],
            cwd=folder,
            env=scratch.environment(folder, STEER_WORKERS="2"),
            stdout=output,
            stderr=output,
            start_new_session=True,
        )
        while repro.poll() is None and f"Running stage '{stage}" not in log.read_text():
            time.sleep(0.02)
        while after_s is None and repro.poll() is None and not list((folder / f"data/.resume/{stage}").glob("*.json")):
            time.sleep(0.005)
        time.sleep(after_s or 0)
        if repro.poll() is None:
            os.killpg(repro.pid, signal.SIGKILL)
            repro.wait()


def finish(folder: Path, stage: str) -> str:
    """Repeat the command after a kill, and return its output."""
    if (folder / RWLOCK).exists():
        try:
            yaml.safe_load((folder / RWLOCK).read_text())
        except yaml.YAMLError:
            (folder / RWLOCK).unlink()  # as README asks for
    output = scratch.run(folder, "dvc", "repro", NAMES.get(stage, stage))
    left = [path for path in (folder / "data").rglob("*") if re.search(r"\.tmp|\.resume/[^/]+/", str(path))]
    assert left == []
    wait_for_the_end(folder)
    return output


def wait_for_the_end(folder: Path) -> None:
    """Wait until no process works in a folder: workers end by themselves when their stage was killed."""
    for _ in range(100):
        if folder.resolve() not in {Path(cwd) for cwd in working_folders()}:
            return
        time.sleep(0.1)
    raise AssertionError(f"processes are left in {folder}")


def working_folders() -> list[str]:
    folders = []
    for process in Path("/proc").glob("[0-9]*/cwd"):
        try:
            folders.append(str(process.readlink()))
        except OSError:
            continue  # ended just now, or another user's
    return folders


@pytest.mark.slow
def test_a_stage_that_is_killed_keeps_its_finished_drives(chain: Path, tmp_path: Path) -> None:
    folder = scratch.duplicate(chain, tmp_path / "killed")
    forget_from(folder, "clouds")
    kill_in(folder, "clouds", after_s=None)
    assert "drives kept from the run before" in finish(folder, "clouds")
    assert scratch.outputs(folder, "clouds") == scratch.outputs(chain, "clouds")


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("stage", scratch.STAGES)
def test_kills_at_random_moments_lose_nothing(chain: Path, tmp_path: Path, stage: str, seed: int) -> None:
    folder = scratch.duplicate(chain, tmp_path / "killed")
    forget_from(folder, stage)
    kill_in(folder, stage, after_s=random.Random(f"{stage}{seed}").uniform(0, 6))
    finish(folder, stage)
    made = scratch.outputs(folder, stage)
    expected = scratch.outputs(chain, stage)
    assert made == {name: content for name, content in expected.items() if name in made or stage != "graphs"}
