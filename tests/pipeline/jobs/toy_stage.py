"""A stage of arithmetic on four drives.

A file ``trouble/<drive>`` makes it fail, wait or die at a frame.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.jobs import console, keys
from pipeline.jobs.outputs import stage_folder
from pipeline.jobs.runner import Job, make_drives

from pipeline.base.checkout import ROOT
from pipeline.base.errors import DamagedFile
from pipeline.labels.label_file import create_labels
from tests.kitti_drive import contents

FRAMES = {"a": 3, "b": 6, "c": 5, "empty": 0}
DRIVES = list(FRAMES)


def work(drive: str, folder: Path, k: int, path: Path) -> dict[str, Any]:
    with (folder / "calls").open("a") as calls:
        calls.write(f"{drive} {os.getpid()}\n")
    rng = np.random.default_rng(len(drive))
    with create_labels(path, drive=drive, params={"k": k}) as file:
        file.put("frame", np.arange(FRAMES[drive], dtype=np.int32))
        for frame in range(FRAMES[drive]):
            if frame == 2:
                _trouble(folder / "trouble" / drive)
            file.append("xyz", rng.normal(size=(3000, 3)).astype(np.float32) * k)
    return {"frames": FRAMES[drive]}


def _trouble(path: Path) -> None:
    """Do what the file asks for."""
    if not path.exists():
        return
    match path.read_text():
        case "fail":
            raise DamagedFile("the file is cut short", "0.png")
        case "die":
            os._exit(9)
        case "die once":
            path.unlink()
            os._exit(9)
        case "wait":
            path.with_name(f"{path.name} waits").write_text(str(os.getpid()))
            wait_for(lambda: not path.exists())


def main(
    folder: Path, k: int = 2, workers: int | None = None, drives: Sequence[str] = DRIVES
) -> dict[str, Any]:
    jobs = []
    for drive in drives:
        inputs = [folder / f"input/{drive}"]
        jobs.append(Job(drive, f"{drive}.h5", inputs, partial(work, drive, folder, k)))
    splits = dict.fromkeys(drives, "train")
    with stage_folder("labels", folder / "data/toy", splits) as stage:
        summaries = make_drives(stage, jobs, {"k": k}, "{frames} frames", workers)
    return summaries


def pretend(name: str, value: str) -> None:
    """Let this process have loaded another file of code, or another version of a package."""
    keys.LOADED[name] = value


def prepare(folder: Path) -> Path:
    """Write a file for each drive, as large as the drive has frames."""
    for name in ("input", "trouble"):
        (folder / name).mkdir()
    for drive, frames in FRAMES.items():
        (folder / "input" / drive).write_bytes(bytes(frames))
    return folder


def outputs(folder: Path) -> dict[str, bytes]:
    return contents(folder / "data/toy")


def calls(folder: Path) -> list[str]:
    """Return the drives that were begun since the last time."""
    path = folder / "calls"
    if not path.exists():
        return []
    drives = [line.split()[0] for line in path.read_text().splitlines()]
    path.unlink()
    return sorted(drives)


def trouble(folder: Path, **drives: str) -> None:
    """Ask for trouble in these drives only."""
    for path in (folder / "trouble").iterdir():
        path.unlink()
    for drive, kind in drives.items():
        (folder / "trouble" / drive).write_text(kind)


def start(folder: Path) -> "subprocess.Popen[str]":
    """Start the stage with two workers in a session of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "tests.pipeline.jobs.toy_stage", str(folder)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        # ignored if the tests run in the background
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def alive(pid: int) -> bool:
    """A process that has ended and waits for its parent (a zombie) is not alive."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def wait_for(condition: Callable[[], bool]) -> None:
    for _ in range(3000):
        if condition():
            return
        time.sleep(0.02)
    raise TimeoutError


def run(folder: Path) -> None:
    main(folder, workers=2)


if __name__ == "__main__":
    console.run(run)
