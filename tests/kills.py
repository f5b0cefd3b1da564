"""The chain killed at random moments of its stages, until it ends by itself: for a test, and longer by hand.

python -m tests.kills 60        # so many kills, then what was lost
"""

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import yaml

from tests import scratch

STAGES = (
    "town", "ingest", "labels", "encoder", "perception", "motion", "scores", "clouds", "pictures", "graphs", "train",
    "evaluate", "report",
)  # fmt: skip
RWLOCK = ".dvc/tmp/rwlock"  # DVC does not write it in one step
KEPT = "kept from the run before"  # what a stage says of what it takes over


class Killed(NamedTuple):
    """What killing a chain has shown."""

    stages: dict[str, int]  # stage → how often it was at work when it was killed
    differing: list[str]  # files that are not those of an undisturbed run
    left_over: list[str]  # files that should not be there
    kept: int  # times that something was taken over from a run before
    mended: int  # times that RWLOCK had to go, which README says


def small(folder: Path) -> Path:
    """Make a scratch copy whose sample is small, with two seeds to train."""
    scratch.copy(folder)
    params = yaml.safe_load((folder / "params.yaml").read_text())
    params["town"] |= {"image_size": [96, 320], "frames": {"train": 40, "val": 12, "test": 12}}
    params["ingest"] |= {
        "image_size": [96, 320],
        "drives": {
            "train": ["2026_01_01_drive_0001..0002"], "val": ["2026_01_02_drive_0001"],
            "test": ["2026_01_03_drive_0001"],
        },
    }  # fmt: skip
    params["encoder"] |= {"epochs": 3, "frames": 40}
    params["graphs"] = {"semantic": params["graphs"]["semantic"] | {"points": 300}}
    params["train"] |= {"epochs": 8, "seeds": [0, 1]}
    (folder / "params.yaml").write_text(yaml.safe_dump(params, sort_keys=False))
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    """Return all that stages have written, without the time that a network took."""
    files = scratch.files_of(folder, list(STAGES))
    clock = re.compile(rb'"encode_ms_per_frame": [\d.]+')
    timed = re.compile(r"data/(train|evaluate|report)/")
    return {
        name: clock.sub(b"", content) if timed.match(name) else content
        for name, content in files.items()
        if not name.startswith("data/report/")  # its page and tables show that time; they are made of the rest
    }


def kill_and_go_on(undisturbed: Path, folder: Path, kills: int, seed: int = 0) -> Killed:
    """Run the chain in both folders, which are alike: whole in the one, with so many kills in the other; compare.

    The chain is killed once in each of some stages, at a random moment; then in others, or in the same ones again.
    """
    status, said, took_s = _run(undisturbed)
    assert status == 0, said
    rng, struck, kept, mended, ended = random.Random(seed), dict.fromkeys(STAGES, 0), 0, 0, False
    while sum(struck.values()) < kills:
        chosen = rng.sample(STAGES, min(len(STAGES), kills - sum(struck.values())))
        for stage in sorted(chosen, key=STAGES.index):
            if ended:
                _forget_from(folder, stage)
            status, said, _ = _run(folder, stage, rng.random() * took_s[stage])
            kept, struck[stage] = kept + said.count(KEPT), struck[stage] + (status == -signal.SIGKILL)
            if status > 0 and "RWLock-file" in said:  # of the kill before
                (folder / RWLOCK).unlink()
                mended += 1
            elif status > 0:
                raise AssertionError(f"after {sum(struck.values())} kills, the same command failed:\n{said}")
            ended = status == 0  # before its moment came
    status, said, _ = _run(folder)
    assert status == 0, said
    _wait_for_the_end(folder)
    ours, theirs = contents(folder), contents(undisturbed)
    differing = sorted(name for name in ours.keys() | theirs.keys() if ours.get(name) != theirs.get(name))
    left_over = sorted(_waiting(folder) - _waiting(undisturbed))
    return Killed(struck, differing, left_over, kept + said.count(KEPT), mended)


def _run(folder: Path, stage: str | None = None, after_s: float = 0.0) -> tuple[int, str, dict[str, float]]:
    """Run the chain, and kill it with all its processes `after_s` after a stage has begun.

    Returns: its status, what it said, and how long each stage took.
    """
    environment = scratch.environment(folder, STEER_WORKERS="2")
    log, began = folder / "chain.log", dict[str, float]()
    with log.open("w") as output:
        chain = subprocess.Popen(
            ["dvc", "repro"], cwd=folder, env=environment, stdout=output, stderr=output, start_new_session=True
        )
        while chain.poll() is None:
            time.sleep(0.02)
            for name in scratch.stages_run(log.read_text(errors="replace")):
                began.setdefault(name.partition("@")[0], time.monotonic())
            if stage in began and time.monotonic() - began[stage] >= after_s:
                os.killpg(chain.pid, signal.SIGKILL)
                chain.wait()
    moments = pairwise([*began.values(), time.monotonic()])
    took_s = {name: end - start for name, (start, end) in zip(began, moments, strict=True)}
    return chain.returncode, log.read_text(errors="replace"), took_s


def _waiting(folder: Path) -> set[str]:
    """Return what only a run in progress should have in data/."""
    paths = (str(path.relative_to(folder)) for path in (folder / "data").rglob("*"))
    return {path for path in paths if re.search(r"\.tmp|\.resume/.", path)}


def _forget_from(folder: Path, stage: str) -> None:
    """Have DVC run a stage, and all after it, once more: their outs and its memory of them go."""
    later = STAGES[STAGES.index(stage) :]
    for name in later:
        shutil.rmtree(folder / "data" / name, ignore_errors=True)
    shutil.rmtree(folder / ".dvc/cache", ignore_errors=True)
    lock = yaml.safe_load((folder / "dvc.lock").read_text())
    lock["stages"] = {name: entry for name, entry in lock["stages"].items() if name.split("@")[0] not in later}
    (folder / "dvc.lock").write_text(yaml.safe_dump(lock, sort_keys=False))


def _wait_for_the_end(folder: Path) -> None:
    """Wait until no process works in a folder any more: workers end by themselves when their stage was killed."""
    for _ in range(100):
        if not any(Path(cwd).resolve() == folder.resolve() for cwd in _working_folders()):
            return
        time.sleep(0.1)
    raise AssertionError(f"processes are left in {folder}")


def _working_folders() -> list[str]:
    folders = []
    for process in Path("/proc").glob("[0-9]*/cwd"):
        try:
            folders.append(str(process.readlink()))
        except OSError:
            continue  # ended just now, or another user's
    return folders


def main(kills: int) -> int:
    """Kill the chain so many times and say what was lost. Return the exit status."""
    with tempfile.TemporaryDirectory() as scratch_folder:
        undisturbed, folder = Path(scratch_folder) / "undisturbed", Path(scratch_folder) / "killed"
        shutil.copytree(small(undisturbed), folder)
        killed = kill_and_go_on(undisturbed, folder, kills)
    print(f"{sum(killed.stages.values())} kills: {killed}")
    return int(bool(killed.differing or killed.left_over))


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
