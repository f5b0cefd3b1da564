"""Describe the revision of the code."""

import shutil
import subprocess
from pathlib import Path

from pipeline.jobs.keys import PACKAGES

from pipeline.base.checkout import ROOT

# Files and folders of the checkout, other than settings, that a run in runs/NAME needs.
CODE = (*PACKAGES, "dvc.yaml", ".dvcignore", "data/.gitignore")


def revision(checkout: Path = ROOT) -> str:
    """Return the short hash of the commit, with "-dirty" if code or settings differ from it.

    The checkout may be a folder of a larger repository. The hash is empty if git is not installed,
    or if the files are in no repository, for instance those of an installed wheel.
    """
    if not shutil.which("git") or not _git(checkout, "ls-files", "dvc.yaml"):
        return ""
    commit = _git(checkout, "rev-parse", "--short", "HEAD").strip()
    watched = (*CODE, "footage", "steer", "presets", "params.yaml")
    status = _git(checkout, "status", "--porcelain", "--", *watched)
    for line in status.splitlines():
        # A new preset, such as one by steer import, does not count: the report of its run shows it.
        if not (line.startswith("??") and "presets/" in line):
            return f"{commit}-dirty"
    return commit


def _git(checkout: Path, *arguments: str) -> str:
    """Return the output of git in a checkout; empty if it fails."""
    command = ["git", *arguments]
    done = subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=False)
    return done.stdout
