"""The folder of the presets, and names that no preset may have."""

import re
from pathlib import Path

from pipeline.base.checkout import ROOT
from pipeline.base.errors import InputError
from pipeline.base.params import read_yaml

# Folder of the presets.
PRESETS = ROOT / "presets"


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
