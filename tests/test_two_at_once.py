"""Two runs at once, by DVC and by hand: each ends right, or one is refused in a line that says by whom."""

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
import yaml

from pipeline.base import resume, store
from tests import artefacts, scratch
from tests.small_model import SPLITS, run_train, write_params

pytestmark = pytest.mark.slow
DRIVE = "2026_01_01_drive_0001"
VERSIONS = 5  # of a file, that each reader is to see
ROWS = 6000  # of a dataset: several chunks


def start(folder: Path, *command: str) -> subprocess.Popen[str]:
    """Start a command in a folder of code; what it says is to be read."""
    environment = scratch.environment(folder, STEER_WORKERS="1")
    return subprocess.Popen(
        command, cwd=folder, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )


@contextmanager
def halted(running: subprocess.Popen[str], stage: str, lock: Path) -> Iterator[None]:
    """Wait until a command has come to a stage, which holds its lock, and halt the stage's process meanwhile."""
    while not (lock.is_file() and lock.read_text().endswith("\n")):
        assert running.poll() is None, running.stdout and running.stdout.read()
        time.sleep(0.01)
    pid = int(lock.read_text().split()[0])
    assert f"stages.{stage}".encode() in Path(f"/proc/{pid}/cmdline").read_bytes()
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    except BaseException:
        running.kill()
        raise
    finally:
        os.kill(pid, signal.SIGCONT)


def ended(running: subprocess.Popen[str]) -> str:
    """Return what a command has said that ended well."""
    said, _ = running.communicate()
    assert running.returncode == 0, said
    return said


def small(folder: Path) -> Path:
    """Make a scratch copy with three drives of a few frames."""
    scratch.copy(folder)
    params = yaml.safe_load((folder / "params.yaml").read_text())
    drives = {"train": [DRIVE], "val": ["2026_01_02_drive_0001"], "test": ["2026_01_03_drive_0001"]}
    scratch.edit_params(
        folder,
        town=params["town"] | {"image_size": [48, 160], "frames": {"train": 8, "val": 6, "test": 6}},
        ingest=params["ingest"] | {"image_size": [48, 160], "drives": drives},
    )
    return folder


def test_two_repros_on_one_clone(tmp_path: Path) -> None:
    folder = small(tmp_path / "clone")
    first = start(folder, "dvc", "repro", "town")
    with halted(first, "town", folder / "data/.resume/town.lock"):
        refused = scratch.run(folder, "dvc", "repro", "labels", check=False)
        by_hand = scratch.run(folder, sys.executable, "-m", "stages.town", check=False)
    assert "data/town' is busy, it is being blocked by:" in refused
    assert "dvc repro town" in refused
    assert by_hand.startswith("error: data/town is being written by process ")
    assert by_hand.count("\n") == 1
    ended(first)
    assert scratch.stages_run(scratch.run(folder, "dvc", "repro", "town")) == []
    assert scratch.stages_run(scratch.run(folder, "dvc", "repro", "labels")) == ["ingest", "labels"]


def test_two_clones_on_one_cache(tmp_path: Path) -> None:
    first, second = clones = [tmp_path / "first", tmp_path / "second"]
    cache = tmp_path / "cache"
    small(first)
    scratch.run(first, "dvc", "cache", "dir", str(cache))
    shutil.copytree(first, second)
    for running in [start(clone, "dvc", "repro", "labels") for clone in clones]:
        ended(running)
    made = [scratch.files_of(clone, ["town", "ingest", "labels"]) for clone in clones]
    assert len(made[0]) > 50
    assert made[0] == made[1]
    assert (first / "dvc.lock").read_bytes() == (second / "dvc.lock").read_bytes()
    whole = [path for path in (cache / "files/md5").rglob("*") if path.is_file()]
    assert whole
    for path in whole:
        wanted = f"{path.parent.name}{path.name}".removesuffix(".dir")
        assert hashlib.md5(path.read_bytes(), usedforsecurity=False).hexdigest() == wanted
    shutil.rmtree(second / "data/town")
    scratch.run(second, "dvc", "checkout", "town")
    assert scratch.files_of(second, ["town", "ingest", "labels"]) == made[0]


def test_two_runs_of_a_stage_by_hand(tmp_path: Path) -> None:
    artefacts.write_dataset(tmp_path, SPLITS, frames=30, points=40)
    write_params(tmp_path, epochs=12)  # so long that it is still at work when it is to be halted
    undisturbed = read(run_train(tmp_path))
    shutil.rmtree(tmp_path / "train")
    places = {"graphs": "graphs", "labels": "labels", "out": "train", "params": "params.yaml"}
    arguments = [f"--{name}={tmp_path / place}" for name, place in places.items()]
    command = [sys.executable, "-m", "stages.train", "net", *arguments]
    first = start(resume.ROOT, *command)
    with halted(first, "train", tmp_path / ".resume/train-net.lock"):
        second = start(resume.ROOT, *command)
        said, _ = second.communicate()
        assert second.returncode == 1
        assert said == (
            f"error: {tmp_path / 'train/net'} is being written by process {first.pid}: wait for it to end, or end it: "
            f"kill {first.pid}\n"
        )
    ended(first)
    assert read(tmp_path / "train/net") == undisturbed
    assert not (tmp_path / ".resume/train-net").exists()


def read(made: Path) -> dict[str, bytes]:
    """Return what a training run has written, without config.json, which has the time that the network took."""
    return {path.name: path.read_bytes() for path in made.iterdir() if path.name != "config.json"}


def write_version(path: Path, version: int) -> None:
    """Write a labels file all of whose numbers say its version."""
    with store.DriveWriter(path, stage="labels", drive=DRIVE, params={"labels": {"version": version}}) as file:
        file.put("frame", np.arange(ROWS, dtype=np.int32))
        file.put("time_s", np.arange(ROWS) / 10)
        for _ in range(3):
            file.append("speed_mps", np.full(ROWS // 3, float(version)))


def versions(file: store.DriveReader) -> set[int]:
    """Return the versions that the parts of a file are of."""
    parts = [file.rows("speed_mps", start, start + 500) for start in range(0, ROWS, 500)]
    return {file.params["labels"]["version"], *np.unique(parts).astype(int).tolist()}


def read_again_and_again(path: Path) -> list[set[int]]:
    """Read the file until several versions were met, or in vain; return which versions each reading met."""
    met: list[set[int]] = []
    while len({*map(frozenset, met)}) < VERSIONS and len(met) < 100_000:
        with store.DriveReader(path, stage="labels") as file:
            met.append(versions(file))
    return met


def test_readers_of_a_file_that_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / f"{DRIVE}.h5"
    write_version(path, 0)
    with store.DriveReader(path, stage="labels") as before:
        assert before.rows("speed_mps", 0, 10).tolist() == [0.0] * 10
        write_version(path, 1)
        with store.DriveReader(path, stage="labels") as after:
            assert versions(after) == {1}
        assert versions(before) == {0}

    version, spawn = 1, multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=spawn) as pool:
        readers = [pool.submit(read_again_and_again, path) for _ in range(2)]
        while not all(reader.done() for reader in readers):
            version += 1
            write_version(path, version)
    for reader in readers:
        met = reader.result()
        assert all(len(versions) == 1 for versions in met)
        order = [version for versions in met for version in versions]
        assert order == sorted(order)
        assert len(set(order)) == VERSIONS
