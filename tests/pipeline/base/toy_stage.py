"""A stage of arithmetic on four drives.

A file ``trouble/<drive>`` makes it fail, wait or die at a frame, ``trouble/index`` before the stage's index.
"""

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.base.errors import DamagedFile
from pipeline.base.outputs import stage_folder
from pipeline.base.resume import ROOT
from pipeline.base.runner import Job, make_drives
from pipeline.base.store import DriveWriter
from tests.kitti_drive import contents

FRAMES = {"a": 3, "b": 6, "c": 5, "empty": 0}
DRIVES = list(FRAMES)
BAD_FRAME = 2


def work(drive: str, folder: Path, k: int, path: Path) -> dict[str, Any]:
    with (folder / "calls").open("a") as calls:
        calls.write(f"{drive} {os.getpid()} {os.environ.get('OMP_NUM_THREADS')}\n")
    rng = np.random.default_rng(len(drive))
    with DriveWriter(path, stage="labels", drive=drive, params={"k": k}) as file:
        file.put("frame", np.arange(FRAMES[drive], dtype=np.int32))
        for frame in range(FRAMES[drive]):
            if frame == BAD_FRAME:
                _trouble(folder / "trouble" / drive)
            file.append("xyz", rng.normal(size=(3000, 3)).astype(np.float32) * k)
    return {"frames": FRAMES[drive]}


def _trouble(path: Path) -> None:
    """Do what the file asks for."""
    match path.read_text() if path.exists() else "":
        case "fail":
            raise DamagedFile("the file is cut short", "0.png")
        case "die":
            os._exit(9)
        case "die once":
            path.unlink()
            os._exit(9)
        case "full":  # like a full disk: no file may grow
            resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
        case "wait":
            path.with_name(f"{path.name} waits").write_text(str(os.getpid()))
            while path.exists():
                time.sleep(0.02)


def main(folder: Path, k: int = 2, workers: int | None = None, drives: Sequence[str] = DRIVES) -> dict[str, Any]:
    jobs = [Job(drive, f"{drive}.h5", [folder / f"input/{drive}"], partial(work, drive, folder, k)) for drive in drives]
    with stage_folder("labels", folder / "data/toy") as stage:
        summaries = make_drives(stage, jobs, {"k": k}, "{frames} frames".format_map, workers)
        _trouble(folder / "trouble/index")
        store.write_index(stage.new, dict.fromkeys(drives, "train"))
    return summaries


def write_inputs(folder: Path) -> None:
    """Write a file for each drive, as large as the drive has frames."""
    (folder / "input").mkdir()
    for drive, frames in FRAMES.items():
        (folder / "input" / drive).write_bytes(bytes(frames))


def outputs(folder: Path) -> dict[str, bytes]:
    return contents(folder / "data/toy")


def calls(folder: Path) -> list[str]:
    """Return the drives that were begun since the last time."""
    path = folder / "calls"
    drives = sorted(line.split()[0] for line in path.read_text().splitlines()) if path.exists() else []
    path.unlink(missing_ok=True)
    return drives


def trouble(folder: Path, **drives: str) -> None:
    for drive, kind in drives.items():
        (folder / "trouble" / drive).write_text(kind)


def end_trouble(folder: Path) -> None:
    for path in (folder / "trouble").iterdir():
        path.unlink()


def start(folder: Path, *options: str, **variables: str) -> "subprocess.Popen[str]":
    environment = {name: value for name, value in os.environ.items() if name != "DVC_STAGE"}
    return subprocess.Popen(
        [sys.executable, "-m", "tests.pipeline.base.toy_stage", str(folder), *options],
        cwd=ROOT,
        env=environment | {"PYTHONPATH": str(ROOT)} | variables,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=_default_interrupt,
    )


def _default_interrupt() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # ignored if the tests run in the background


def waiting(folder: Path, drives: Sequence[str]) -> list[int]:
    """Wait until these drives have begun to wait; return the ids of their processes."""
    paths = [folder / f"trouble/{drive} waits" for drive in drives]
    wait_for(lambda: all(path.exists() and path.read_text() for path in paths))
    return [int(path.read_text()) for path in paths]


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


def run(folder: Path, workers: int = 1) -> None:
    main(folder, workers=workers)


if __name__ == "__main__":
    from pipeline.base import console

    console.run(run)
