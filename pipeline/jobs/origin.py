"""Say where results come from: revision, date, machine, and the preset of ``make NAME``."""

import json
import os
import time
from datetime import date
from pathlib import Path
from typing import Any

from pipeline.jobs.revision import revision

from pipeline.base.checkout import ROOT

# Name of the file in which ``make NAME`` describes a run when it starts it. The file is in the
# folder runs/NAME, which holds a copy of the code.
RUN = "run.json"


def read_run(folder: Path = ROOT) -> dict[str, Any]:
    """Return the description of a run in a copy of the code.

    Its keys are preset, revision, started_s, settings (those of the preset) and files. A
    checkout has no such file. Its description is only the revision.
    """
    path = folder / RUN
    if path.is_file():
        return json.loads(path.read_text(encoding="utf-8"))
    return {"revision": revision(folder)}


def describe_origin(folder: Path = ROOT) -> dict[str, str]:
    """Return the origin of results, which is kept with them.

    `folder` is a checkout or a copy of the code.
    """
    from torch import cuda

    run = read_run(folder)
    made = {"preset": run["preset"]} if "preset" in run else {}
    made["revision"] = run["revision"] or "unknown"
    made["date"] = str(date.today())
    made["machine"] = f"{os.cpu_count()} CPU cores"
    if cuda.is_available():
        made["machine"] = cuda.get_device_name()
    return made


def format_duration(run: dict[str, Any]) -> str:
    """Return the time since the start of a run."""
    return f"{(time.time() - run['started_s']) / 60:.1f} min"
