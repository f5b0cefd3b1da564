"""Each stage on a disk with too little space, and on a read-only one: for a test, and longer by hand.

unshare --map-root-user --mount python -m tests.disks 0 0.5 0.9    # shares of the space that a stage takes
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

from tests import kills, scratch

# A name space of its own: what is mounted there goes with the process, and nobody else sees it.
UNSHARE = ("unshare", "--map-root-user", "--mount")
COMMAND = (*UNSHARE, sys.executable, "-m", "tests.disks")
_MODEL, _VARIANT = "sa-gnn-ncp", "semantic"
_OF = {"graphs": _VARIANT, "train": _MODEL, "evaluate": _MODEL}  # a stage of many → the one that runs here
_PAGE = 4096
_PLENTY = "4g"
_SAYS = {"full": "No space left on device while writing data/", "read-only": "Read-only file system: data/"}


class Trial(NamedTuple):
    """A stage that met a disk."""

    stage: str
    disk: str  # full or read-only
    free: int  # bytes
    status: int
    said: str  # on stderr
    changed: list[str]  # of what other stages had written
    left_over: list[str]  # temporary files
    differing: list[str]  # of what the same command wrote once there was space

    @property
    def faults(self) -> list[str]:
        """What a user should not meet; none if all went well."""
        errors = [line for line in self.said.splitlines() if line.startswith("error: ")]
        found = {
            "it did not fail": self.status == 0,
            "a traceback": "Traceback" in self.said,
            "no line, or several": len(errors) != 1,
            "another line": not any(_SAYS[self.disk] in line for line in errors),
            f"changed {self.changed}": bool(self.changed),
            f"left over {self.left_over}": bool(self.left_over),
            f"differing {self.differing}": bool(self.differing),
        }
        return [fault for fault, there in found.items() if there]


class Disk:
    """A tmpfs on a scratch copy's data/, with what an undisturbed run has written there."""

    def __init__(self, folder: Path) -> None:
        """Mount it; `folder` is a scratch copy whose chain has run."""
        self.folder, self.data = folder, folder / "data"
        self.whole = kills.contents(folder)
        written = folder / "written"
        self.data.rename(written)
        self.data.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={_PLENTY}", "tmpfs", str(self.data)], check=True)
        shutil.copytree(written, self.data, dirs_exist_ok=True)

    def used(self) -> int:
        """Return the bytes in use."""
        stat = os.statvfs(self.data)
        return (stat.f_blocks - stat.f_bfree) * stat.f_frsize

    def remount(self, options: str) -> None:
        """Change what the disk allows: its size, whether it is written to."""
        subprocess.run(["mount", "-o", f"remount,{options}", str(self.data)], check=True)

    def run(self, stage: str) -> subprocess.CompletedProcess[str]:
        """Run a stage as DVC does."""
        environment = scratch.environment(self.folder, STEER_WORKERS="2")
        command = [sys.executable, "-m", f"stages.{stage}", *([_OF[stage]] if stage in _OF else [])]
        return subprocess.run(command, cwd=self.folder, env=environment, capture_output=True, text=True, check=False)

    def meet(self, stage: str, share: float | None) -> Trial:
        """Run a stage with a share of the space that it takes, or on a read-only disk (None); then with plenty."""
        before = self.used()
        for path in self.data.glob(f"{stage}/*" if stage != "clouds" else "clouds/*/*"):  # as DVC does
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        free = int((before - self.used()) * (share or 0)) // _PAGE * _PAGE
        self.remount("ro" if share is None else f"size={max(self.used() + free, _PAGE)}")
        met = self.run(stage)
        self.remount(f"rw,size={_PLENTY}")
        now = kills.contents(self.folder)
        others = [name for name in self.whole if not name.startswith(f"data/{stage}/")]
        left_over = [str(path.relative_to(self.folder)) for path in self.data.rglob("*.tmp")]
        changed = [name for name in others if now.get(name) != self.whole[name]]
        again = self.run(stage)
        assert again.returncode == 0, again.stderr
        now = kills.contents(self.folder)
        differing = sorted(name for name in now.keys() | self.whole.keys() if now.get(name) != self.whole.get(name))
        disk = "read-only" if share is None else "full"
        return Trial(stage, disk, free, met.returncode, met.stderr, changed, left_over, differing)


def possible() -> bool:
    """Say whether this system lets a user mount a tmpfs in a name space of his own."""
    if not shutil.which(UNSHARE[0]):
        return False
    return subprocess.run([*UNSHARE, "mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True).returncode == 0


def main(shares: Sequence[float]) -> int:
    """Let each stage meet a read-only disk, and full ones; print what happened. Return how many trials went wrong."""
    with tempfile.TemporaryDirectory() as scratch_folder:
        folder = kills.small(Path(scratch_folder) / "copy")
        scratch.run(folder, "dvc", "repro")
        disk = Disk(folder)
        trials, failed = 0, 0
        try:
            for stage, share in product(kills.STAGES, (None, *shares)):
                trial = disk.meet(stage, share)
                line = f"{stage:<11} {trial.disk:<9} {trial.free / 1024:>8.0f} KiB free"
                print(line, *trial.faults or ["as it should"], *([trial.said] if trial.faults else []), flush=True)
                trials, failed = trials + 1, failed + bool(trial.faults)
        finally:
            subprocess.run(["umount", str(disk.data)], check=True)
    print(f"{trials} trials, {failed} failed")
    return failed


if __name__ == "__main__":
    sys.exit(bool(main([float(share) for share in sys.argv[1:]])))
