"""Which stages of a project have to run, as DVC sees it."""

import os
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.inspect.reading import json_object, mapping


def busy(project: Path) -> str:
    """Return the command of a DVC that runs a stage here now; nothing if none does.

    To ask DVC for its status then is to compete for its locks, at which a run of many hours could end.
    """
    try:
        lock = json_object(project / ".dvc" / "tmp" / "rwlock")
    except (InputError, FileNotFoundError):
        return ""
    writers = (mapping(writer) for writer in mapping(lock.get("write")).values())
    return next((str(writer.get("cmd")) for writer in writers if _alive(writer.get("pid"))), "")


def _alive(pid: Any) -> bool:
    try:
        os.kill(int(pid), 0)
    except PermissionError:  # another user's
        return True
    except (OSError, ValueError, TypeError, OverflowError):
        return False
    return True


def due(project: Path) -> dict[str, str]:
    """Return stage → why it has to run, in the order in which they run; empty if everything is up to date.

    What follows from a stage that has to run, has to run too, unless that makes what it made before.

    Raises InputError if DVC cannot say, for instance because another run holds its lock.
    """
    from dvc.exceptions import DvcException
    from dvc.repo import Repo
    from networkx import ancestors, topological_sort

    try:
        with Repo(str(project)) as repo:
            status, graph = repo.status(), repo.index.graph
            reasons = {_name(address): _reason(parts) for address, parts in status.items()}
            names = {stage: _name(stage.addressing) for stage in graph}
            for stage in graph:
                if names[stage] in reasons and not any(dep.hash_info for dep in stage.deps):
                    reasons[names[stage]] = "it has not run here"
            for stage in [stage for stage in graph if names[stage] in reasons]:
                for later in ancestors(graph, stage):  # an edge leads from a stage to what it is made of
                    reasons.setdefault(names[later], f"follows {names[stage]}")
            order = [names[stage] for stage in topological_sort(graph)][::-1]
    except DvcException as error:
        said = " ".join(str(error).split()).rstrip(".")
        raise InputError(f"DVC cannot say which stage has to run: {said}. Try: dvc status") from error
    return {name: reasons[name] for name in order if name in reasons}


def _name(address: str) -> str:
    """Return a stage's name, without the file that DVC puts before it where it is called from elsewhere."""
    return address.rpartition(":")[2]


def _reason(parts: list[Any]) -> str:
    """Return in words what DVC lists of one stage: what changed, at most three of them."""
    said = []
    for part in parts:
        if not isinstance(part, dict):
            said.append(str(part))
            continue
        for kind, entries in part.items():
            names = list(entries) if isinstance(entries, dict) else [str(entries)]
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            said.append(f"{kind}: {', '.join(map(str, names[:3]))}{more}")
    return "; ".join(said)
