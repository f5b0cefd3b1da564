"""Where results come from: revision, date and machine, and the preset of ``make NAME``."""

import json
import os
import time
from datetime import date
from pathlib import Path
from typing import Any

from pipeline.base.resume import ROOT, revision

# File in runs/NAME, a copy of the code: what ``make NAME`` knows of the run when it starts it.
RUN = "run.json"


def read_run(folder: Path = ROOT) -> dict[str, Any]:
    """Return RUN of a copy of the code: preset, revision, started_s, settings and next command.

    `settings`: what differs from params.yaml. Of a checkout, which has no such file: revision.
    """
    path = folder / RUN
    if path.is_file():
        return json.loads(path.read_text(encoding="utf-8"))
    return {"revision": revision(folder)}


def origin(folder: Path = ROOT) -> dict[str, str]:
    """Return what is kept of a run beside its results; `folder`: a checkout or a copy."""
    from torch import cuda

    run = read_run(folder)
    made = {"preset": run["preset"]} if "preset" in run else {}
    made["revision"] = run["revision"] or "unknown"
    made["date"] = str(date.today())
    made["machine"] = f"{os.cpu_count()} CPU cores"
    if cuda.is_available():
        made["machine"] = cuda.get_device_name()
    return made


def duration(run: dict[str, Any]) -> str:
    """Return the time since the start of a run."""
    return f"{(time.time() - run['started_s']) / 60:.1f} min"
