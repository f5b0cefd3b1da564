"""Two processes at once: each ends as if alone, or one is refused in one line."""

import hashlib
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from tests import scratch
from tests.test_kills import forget_from

pytestmark = pytest.mark.slow
DRIVE = "2026_01_01_drive_0001"
VERSIONS = 3  # of a file, that each reader has to meet
ROWS = 6000  # of a dataset: several chunks


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


@pytest.mark.soak
def test_two_clones_on_one_cache(chain: Path, tmp_path: Path) -> None:
    first, second = clones = [tmp_path / "first", tmp_path / "second"]
    cache = tmp_path / "cache"
    forget_from(scratch.duplicate(chain, first), "town")
    scratch.run(first, "dvc", "cache", "dir", str(cache))
    scratch.duplicate(first, second)
    for running in [start(clone, "dvc", "repro", "labels") for clone in clones]:
        wait_for_success(running)
    made = [scratch.outputs(clone, "town", "ingest", "labels") for clone in clones]
    assert len(made[0]) > 50
    assert made[0] == made[1]
    assert (first / "dvc.lock").read_bytes() == (second / "dvc.lock").read_bytes()
    objects = [path for path in (cache / "files/md5").rglob("*") if path.is_file()]
    assert objects
    for path in objects:
        expected = f"{path.parent.name}{path.name}".removesuffix(".dir")
        assert hashlib.md5(path.read_bytes(), usedforsecurity=False).hexdigest() == expected


def write_version(path: Path, version: int) -> None:
    """Write a labels file in which all numbers are its version."""
    with store.DriveWriter(path, stage="labels", drive=DRIVE, params={"labels": {"version": version}}) as file:
        file.put("frame", np.arange(ROWS, dtype=np.int32))
        file.put("time_s", np.arange(ROWS) / 10)
        for _ in range(3):
            file.append("speed_mps", np.full(ROWS // 3, float(version)))


def versions(file: store.DriveReader) -> set[int]:
    """Return the versions of the parts of a file."""
    parts = [file.rows("speed_mps", start, start + 500) for start in range(0, ROWS, 500)]
    return {file.params["labels"]["version"], *np.unique(parts).astype(int).tolist()}


def read_again_and_again(path: Path) -> list[set[int]]:
    """Read the file until several versions were met; return the versions that each reading met."""
    met: list[set[int]] = []
    while len({*map(frozenset, met)}) < VERSIONS and len(met) < 100_000:
        with store.DriveReader(path, stage="labels") as file:
            met.append(versions(file))
    return met


def test_readers_of_a_file_that_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / f"{DRIVE}.h5"
    write_version(path, 0)
    with store.DriveReader(path, stage="labels") as before:
        write_version(path, 1)
        with store.DriveReader(path, stage="labels") as after:
            assert versions(after) == {1}
        assert versions(before) == {0}

    version, spawn = 1, multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn) as pool:
        reader = pool.submit(read_again_and_again, path)
        while not reader.done():
            version += 1
            write_version(path, version)
    met = reader.result()
    assert all(len(versions) == 1 for versions in met), "a file of two versions"
    order = [version for versions in met for version in versions]
    assert order == sorted(order)
    assert len(set(order)) == VERSIONS
