"""Where results come from: revision, date and machine."""

import os
from datetime import date
from pathlib import Path

from pipeline.base.resume import ROOT, revision

# File in runs/NAME, a copy of the code, with the commit.
REVISION = "revision"


def origin(folder: Path = ROOT) -> dict[str, str]:
    """Return what is kept of a run beside its results; `folder`: a checkout, or a copy of its
    code.
    """
    from torch import cuda

    copied = folder / REVISION
    commit = copied.read_text("ascii") if copied.is_file() else revision(folder)
    machine = cuda.get_device_name() if cuda.is_available() else f"{os.cpu_count()} CPU cores"
    return {"revision": commit or "unknown", "date": str(date.today()), "machine": machine}
