"""Stages on a disk that is full or read-only: one line, nothing is lost, and the same command goes on."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from pipeline.base.resume import ROOT
from tests import scratch

# A name space of its own: the mount ends with the process, and other processes do not have it.
UNSHARE = ("unshare", "--map-root-user", "--mount")
ENTRIES = {"graphs": "semantic", "train": scratch.MODEL, "evaluate": scratch.MODEL}
PAGE = 4096
PLENTY = "2g"
MESSAGES = {"full": "No space left on device", "read-only": "Read-only file system"}


def possible() -> bool:
    """Return whether this system lets a user mount a tmpfs in a name space of its own."""
    if not shutil.which(UNSHARE[0]):
        return False
    return subprocess.run([*UNSHARE, "mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True).returncode == 0


pytestmark = pytest.mark.skipif(not possible(), reason=f"{' '.join(UNSHARE)} may not mount a tmpfs here")


class Disk:
    """A tmpfs on a scratch copy's data/, with the outputs of an undisturbed run."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.data = folder, folder / "data"
        self.expected = scratch.outputs(folder, *scratch.STAGES)
        written = folder / "written"
        self.data.rename(written)
        self.data.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={PLENTY}", "tmpfs", str(self.data)], check=True)
        shutil.copytree(written, self.data, dirs_exist_ok=True)

    def used(self) -> int:
        stat = os.statvfs(self.data)
        return (stat.f_blocks - stat.f_bfree) * stat.f_frsize

    def remount(self, options: str) -> None:
        subprocess.run(["mount", "-o", f"remount,{options}", str(self.data)], check=True)

    def run(self, stage: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", f"stages.{stage}", *([ENTRIES[stage]] if stage in ENTRIES else [])]
        environment = scratch.environment(self.folder)
        return subprocess.run(command, cwd=self.folder, env=environment, capture_output=True, text=True, check=False)

    def trial(self, stage: str, share: float | None) -> dict[str, Any]:
        """Run a stage with a share of the space that it takes, or on a read-only disk (None); then with plenty."""
        before = self.used()
        for path in self.data.glob(f"{stage}/*" if stage != "clouds" else "clouds/*/*"):  # as DVC does
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        free = int((before - self.used()) * (share or 0)) // PAGE * PAGE
        self.remount("ro" if share is None else f"size={max(self.used() + free, PAGE)}")
        failed = self.run(stage)
        self.remount(f"rw,size={PLENTY}")
        return {
            "status": failed.returncode,
            "stderr": failed.stderr,
            "changed": self.differences(own=False, stage=stage),
            "temporary": [str(path) for path in self.data.rglob("*.tmp")],
            "repeated": self.run(stage).stderr,
            "differing": self.differences(own=True, stage=stage),
        }

    def differences(self, own: bool, stage: str) -> list[str]:
        """Return the outputs of this stage, or of the other ones, that are not those of the undisturbed run."""
        now = scratch.outputs(self.folder, *scratch.STAGES)
        names = [name for name in now.keys() | self.expected.keys() if name.startswith(f"data/{stage}/") == own]
        return sorted(name for name in names if now.get(name) != self.expected.get(name))


def check(chain: Path, folder: Path, stage: str, shares: list[float | None]) -> None:
    scratch.duplicate(chain, folder)
    command = [*UNSHARE, sys.executable, "-m", "tests.test_disks", str(folder), stage, json.dumps(shares)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    trials = json.loads(done.stdout)
    assert len(trials) == len(shares)
    for share, trial in zip(shares, trials, strict=True):
        assert trial["status"] == 1, trial
        errors = [line for line in trial["stderr"].splitlines() if line.startswith("error: ")]
        assert len(errors) == 1, trial
        assert MESSAGES["read-only" if share is None else "full"] in errors[0]
        assert "data/" in errors[0]
        assert "Traceback" not in trial["stderr"]
        assert not trial["changed"] + trial["temporary"] + trial["differing"], trial


@pytest.mark.slow
def test_a_full_or_read_only_disk_loses_nothing(chain: Path, tmp_path: Path) -> None:
    check(chain, tmp_path / "copy", "clouds", [0.5, None])


@pytest.mark.soak
@pytest.mark.parametrize("stage", scratch.STAGES)
def test_a_full_or_read_only_disk_loses_nothing_in_any_stage(chain: Path, tmp_path: Path, stage: str) -> None:
    check(chain, tmp_path / "copy", stage, [None, 0, 0.5, 0.9])


def main(folder: Path, stage: str, shares: list[float | None]) -> None:
    disk = Disk(folder)
    print(json.dumps([disk.trial(stage, share) for share in shares]))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], json.loads(sys.argv[3]))
