"""Names of presets, and stamped files: those that steer import wrote, and may replace."""

import hashlib
import re
from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.base.params import read_yaml
from pipeline.base.resume import ROOT

# Folder of the presets.
PRESETS = ROOT / "presets"
# Start of the first line of a stamped file.
_STAMP = "# Written by "
# Author of stamped files that steer import writes.
IMPORT = "steer import"


def stamped(content: str, author: str) -> str:
    """Return the content of a file below a line with its author and its hash."""
    digest = hashlib.sha256(content.encode()).hexdigest()
    return f"{_STAMP}{author}; SHA-256 of the other lines: {digest}\n{content}"


def author_of(path: Path) -> str:
    """Return the author of a :func:`stamped` file, even if it was edited, or an empty text."""
    if not path.exists():
        return ""
    first = path.read_text("utf-8", errors="replace").partition("\n")[0]
    if not first.startswith(_STAMP):
        return ""
    return first.removeprefix(_STAMP).partition(";")[0]


def is_unedited(path: Path) -> bool:
    """Return whether a file is as :func:`stamped` returned it."""
    first, _, content = path.read_text("utf-8", errors="replace").partition("\n")
    return first.endswith(f" {hashlib.sha256(content.encode()).hexdigest()}")


def check_name_is_free(name: str) -> None:
    """Raise InputError if a preset's name is another target of make, or a file in data/report."""
    targets = re.findall("^([a-z]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    if name in targets:
        raise InputError("is a target of make", name, "Choose another name")
    outs = read_yaml(ROOT / "dvc.yaml")["stages"]["report"]["outs"]
    # The page of the run would replace that file, and its hard link in DVC's cache. Case is
    # ignored, as some disks ignore it.
    if name.lower() in {Path(out).stem for out in outs}:
        problem = "is the name of a file that stage report writes"
        raise InputError(problem, name, "Choose another name")
