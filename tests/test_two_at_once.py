"""Two processes at once: each ends as if alone, or one is refused in one line."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests import scratch
from tests.test_kills import forget_from

pytestmark = pytest.mark.slow


def start(folder: Path, *command: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        command,
        cwd=folder,
        env=scratch.environment(folder),
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )


def process_of(folder: Path, stage: str) -> int | None:
    """Return the id of the process that runs a stage in a folder."""
    for path in Path("/proc").glob("[0-9]*"):
        try:
            command = (path / "cmdline").read_bytes().split(b"\0")
            if f"stages.{stage}".encode() in command and (path / "cwd").readlink() == folder.resolve():
                return int(path.name)
        except OSError:
            continue  # ended just now
    return None


@contextmanager
def halted(running: "subprocess.Popen[str]", folder: Path, stage: str) -> Iterator[None]:
    """Halt the process of a stage that holds its lock."""
    while not (pid := process_of(folder, stage)) or not (folder / f"data/.resume/{stage}.lock").exists():
        assert running.poll() is None, running.stdout and running.stdout.read()
        time.sleep(0.01)
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    except BaseException:
        running.kill()
        raise
    finally:
        os.kill(pid, signal.SIGCONT)


def wait_for_success(running: "subprocess.Popen[str]") -> None:
    output, _ = running.communicate()
    assert running.returncode == 0, output


def test_two_repros_on_one_clone(chain: Path, tmp_path: Path) -> None:
    folder = scratch.duplicate(chain, tmp_path / "clone")
    forget_from(folder, "town")
    shutil.rmtree(folder / "data/.resume")
    first = start(folder, "dvc", "repro", "town")
    with halted(first, folder, "town"):
        refused = scratch.run(folder, "dvc", "repro", "town", check=False)
        by_hand = scratch.run(folder, sys.executable, "-m", "stages.town", check=False)
    assert "data/town' is busy" in refused
    assert by_hand.startswith("error: data/town: ")
    assert by_hand.count("\n") == 1
    wait_for_success(first)
    assert scratch.outputs(folder, "town") == scratch.outputs(chain, "town")
