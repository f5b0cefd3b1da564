"""Stages on a disk that is full or read-only: one line, nothing lost, and the same command goes on."""

import subprocess

import pytest

from pipeline.base import resume
from tests import disks


@pytest.mark.slow
@pytest.mark.skipif(not disks.possible(), reason=f"{' '.join(disks.UNSHARE)} may not mount a tmpfs here")
def test_a_full_or_read_only_disk_loses_nothing_in_any_stage() -> None:
    done = subprocess.run([*disks.COMMAND, "0.5"], cwd=resume.ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "26 trials, 0 failed" in done.stdout
