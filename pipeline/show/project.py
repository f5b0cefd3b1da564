"""Project of DVC: which stages it would run, disk space, and which stage wrote an artefact."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.base.files import read_yaml
from pipeline.base.params import entries, load, load_entry
from pipeline.settings.ingest import Ingest
from pipeline.settings.labels import Labels
from pipeline.settings.models import Entry
from pipeline.show.artefact import damage_as_input_error

Stages = Mapping[str, Mapping[str, Any]]
NOT_RUN = "has not run here"  # why a stage is due


@dataclass
class Project:
    """Result for one project."""

    folder: Path
    free_bytes: int
    ingest: Ingest | None = None
    needs_oxts: bool = True
    due: dict[str, str] = field(default_factory=dict)
    """Stage → why it has to run, in the order of the run."""
    due_bytes: int = 0
    """Size of the last outputs of these stages."""
    unused: list[str] = field(default_factory=list)
    """Stages that are due, but needed by no model."""
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def kitti_drives(self) -> list[str]:
        """Return the drives that params.yaml takes from KITTI raw."""
        sources = self.ingest.sources() if self.ingest else {}
        return [drive for drive, source in sources.items() if source == "kitti"]


def check(folder: Path) -> Project:
    """Check a project's params.yaml, the stages that are due, and whether their outputs fit on the disk."""
    project = Project(folder, shutil.disk_usage(folder).free)
    params = folder / "params.yaml"
    try:
        project.ingest = load(Ingest, params)
        project.needs_oxts = load(Labels, params).source == "oxts"
        used = {f"graphs@{load_entry(Entry, 'models', name, params).input}" for name in entries("models", params)}
        command = running_command(folder)
        if command:
            project.notes.append(f"DVC is running here ({command}): run steer doctor again when it has ended")
            return project
        due = due_stages(folder)
        lock = read_lock(folder)
    except InputError as error:
        project.problems.append(str(error))
        return project
    project.unused = [stage for stage in due if stage.startswith("graphs@") and stage not in used]
    project.due = {stage: reason for stage, reason in due.items() if stage not in project.unused}
    project.due_bytes = sum(out.get("size", 0) for stage in project.due for out in lock.get(stage, {}).get("outs", []))
    if project.due_bytes > project.free_bytes:
        problem = f"the stages that have to run wrote {project.due_bytes / 1e9:.1f} GB in their last run"
        project.problems.append(f"{problem}, {project.free_bytes / 1e9:.1f} GB are free. Free some space")
    return project


def running_command(folder: Path) -> str:
    """Return the command of a DVC process that runs a stage here; empty if none is running.

    Running `dvc status` now could fail the run, because both need the lock.
    """
    try:
        writers = [*json.loads((folder / ".dvc" / "tmp" / "rwlock").read_text())["write"].values()]
        commands = [str(writer["cmd"]) for writer in writers if _is_running(writer["pid"])]
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return ""
    return next(iter(commands), "")


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)  # sends no signal; raises if the process has ended
    except PermissionError:  # a process of another user
        return True
    except (OSError, OverflowError):
        return False
    return True


def due_stages(folder: Path) -> dict[str, str]:
    """Return stage → why it has to run, in the order of the run. Raises InputError if DVC fails.

    Stages that depend on a stage that is due are due as well.
    """
    status = json.loads(_dvc(folder, "status", "--json"))
    if not status:
        return {}
    inputs: dict[str, list[str]] = {}
    for name, later in re.findall(r'^"(.+?)"(?: -> "(.+)")?;$', _dvc(folder, "dag", "--dot"), re.MULTILINE):
        inputs.setdefault(later or name, []).extend([name] if later else [])
    lock = read_lock(folder)
    due: dict[str, str] = {}
    for stage in TopologicalSorter(inputs).static_order():
        if stage in status:
            due[stage] = _reason(status[stage]) if stage in lock else NOT_RUN
        elif changed := next((name for name in inputs[stage] if name in due), ""):
            due[stage] = due[changed] if due[changed].startswith("needs ") else f"needs {changed}"
    return due


def _dvc(folder: Path, *command: str) -> str:
    """Return what a command of DVC prints. Raises InputError if it fails."""
    environment = os.environ | {"DVC_NO_ANALYTICS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "dvc", *command], cwd=folder, env=environment, capture_output=True, text=True
    )
    if done.returncode:
        reason = " ".join(done.stderr.split()).removeprefix("ERROR: ").rstrip(".")[:200]
        raise InputError(f"dvc {command[0]} failed: {reason}", folder, f"See: dvc {command[0]}")
    return done.stdout


def _reason(changes: list[Any]) -> str:
    """Return what `dvc status` lists for one stage as text, at most three names of each kind of change."""
    kinds = [kind for change in changes for kind in (change.items() if isinstance(change, dict) else [(change, [])])]
    return "; ".join(
        f"{kind}: {', '.join([*names][:3])}{', …' if len(names) > 3 else ''}" if names else kind
        for kind, names in kinds
    )


def project_root(path: Path) -> Path | None:
    """Return the nearest folder at or above `path` that has a dvc.yaml or dvc.lock."""
    for start in (path.absolute(), path.resolve()):  # data/ may be a link to another disk
        for folder in (start, *start.parents):
            if (folder / "dvc.yaml").is_file() or (folder / "dvc.lock").is_file():
                return folder
    return None


def read_lock(project: Path) -> Stages:
    """Return stage → its entry in dvc.lock; empty if there is no dvc.lock. Raises InputError if it is damaged."""
    lock = project / "dvc.lock"
    if not lock.is_file():
        return {}
    fix = "Restore it: git checkout dvc.lock. Or delete it, then run: dvc repro"
    with damage_as_input_error(lock, fix):
        stages = read_yaml(lock)["stages"]
        for stage in stages.values():
            _paths(stage, "deps"), _paths(stage, "outs")
    return stages


def _paths(stage: Mapping[str, Any], kind: str) -> list[str]:
    return [entry["path"] for entry in stage.get(kind, [])]


def trace(path: Path) -> dict[str, str]:
    """Return facts on where `path` comes from, by dvc.lock. Raises InputError if dvc.lock is damaged."""
    project = project_root(path)
    stages = read_lock(project) if project else {}
    if project is None or not stages:
        return {"written by": "unknown: there is no dvc.lock in the folders above"}
    place = path.absolute() if path.absolute().is_relative_to(project) else path.resolve()
    names = _writers(place.relative_to(project).as_posix(), stages)
    facts = {"written by": ", ".join(names) or f"unknown: no stage in {project / 'dvc.lock'} writes it"}
    if len(names) == 1:
        inputs = (path for path in _paths(stages[names[0]], "deps") if _writers(path, stages))
        facts["inputs"] = ", ".join(inputs) or "none"
    return facts


def _overlap(a: str, b: str) -> bool:
    """Return whether one of two paths is the other, or holds it."""
    return a in (b, ".") or a.startswith(f"{b}/") or b.startswith(f"{a}/")


def _writers(path: str, stages: Stages) -> list[str]:
    return [name for name, stage in stages.items() if any(_overlap(path, out) for out in _paths(stage, "outs"))]
