"""Trace an artefact back through dvc.lock to its stage and its inputs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.base import yaml_file
from pipeline.inspect.reading import read_errors

Stages = Mapping[str, Mapping[str, Any]]


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
    with read_errors(lock, fix):
        stages = yaml_file.read(lock)["stages"]
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
