"""Where an artefact came from: the stages that made it, by the dvc.lock beside it, back to the raw drive."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from pipeline.base.errors import InputError
from pipeline.inspect.code_hash import CodeHashes
from pipeline.inspect.reading import damage_told, mapping, size_of, text

LOCK, FILE, PARAMS = "dvc.lock", "dvc.yaml", "params.yaml"
Stage = dict[str, Any]


def project_of(path: Path) -> Path | None:
    """Return the nearest folder above `path` that has a dvc.yaml or dvc.lock; None if there is none."""
    for start in (path.absolute(), path.resolve()):  # as it was called, and where links lead
        for folder in start.parents if start.is_file() else (start, *start.parents):
            if (folder / FILE).is_file() or (folder / LOCK).is_file():
                return folder
    return None


def chain(path: Path) -> dict[str, Any]:
    """Return which stages made what lies at `path`, the last one first.

    Returns: ``project``, and ``stages``, each with its ``name``, ``cmd``, ``settings`` (of dvc.lock), which of them
    stand otherwise in params.yaml now (``settings_now``), ``inputs`` (path → hash, of data), ``remade`` (inputs that
    were made again since, so that what follows is not what this was made of), ``code`` (path → same, changed or
    missing) and ``outputs``. ``unread`` says why params.yaml could not be compared. ``altered``: outputs of the last
    stages that have other sizes than dvc.lock says. No stages where no dvc.lock knows the path; ``why`` says so.
    """
    project = project_of(path)
    if project is None:
        return {"project": None, "stages": [], "why": f"no {LOCK} in a folder above"}
    if not (project / LOCK).is_file():
        return {"project": str(project), "stages": [], "why": f"{project / LOCK} is missing: no dvc repro ended here"}
    stages = _stages(project / LOCK)
    place = _place(path, project)
    last = [name for name, stage in stages.items() if any(_meet(place, out) for out in _paths(stage, "outs"))]
    if place is None or not last:
        return {"project": str(project), "stages": [], "why": f"{project / LOCK} knows no stage that made this"}
    now, unread = _settings_now(project / PARAMS)
    code = CodeHashes(project)
    made = {out: md5 for stage in stages.values() for out, md5 in _paths(stage, "outs").items()}
    return {
        "project": str(project),
        "unread": unread,
        "stages": [_told(name, stages[name], made, now, code) for name in _upstream(last, stages)],
        "altered": [out for name in last for out in _altered(project, stages[name])],
    }


def _stages(lock: Path) -> dict[str, Stage]:
    stages = mapping(_yaml(lock).get("stages"))
    whole = {name: stage for name, stage in stages.items() if isinstance(stage, dict)}
    if not whole:
        raise InputError(
            f"{lock} is damaged: it holds no stages. Bring it back: git checkout {lock.name}, or dvc repro"
        )
    return whole


def _settings_now(params: Path) -> tuple[dict[str, Any], str]:
    """Return what params.yaml holds, and why that cannot be compared, if it cannot."""
    try:
        return _yaml(params), ""
    except (InputError, FileNotFoundError) as error:
        return {}, " ".join(str(error).split())


def _yaml(path: Path) -> dict[str, Any]:
    content = text(path)
    with damage_told(path, hint=f"Bring it back: git checkout {path.name}"):
        return mapping(yaml.load(content, Loader=_Plain))  # the C parser is quicker, and crashes on "[[[[…"


class _Plain(yaml.SafeLoader):
    """YAML without aliases, which nest to sizes that nobody can print; DVC writes none."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise ValueError("it has YAML aliases")
        return super().compose_node(parent, index)


def _place(path: Path, project: Path) -> str | None:
    for absolute in (path.absolute(), path.resolve()):
        if absolute.is_relative_to(project):
            return absolute.relative_to(project).as_posix()
    return None


def _meet(place: str | None, out: str) -> bool:
    """Say whether `place` is the output, lies in it, or holds it, as data/graphs holds each variant."""
    return place is not None and (
        place == out or place.startswith(f"{out}/") or out.startswith(f"{place}/") or place == "."
    )


def _paths(stage: Stage, kind: str) -> dict[str, str]:
    """Return path → hash of a stage's deps or outs."""
    return {str(entry.get("path")): str(entry.get("md5", "unknown")) for entry in _entries(stage, kind)}


def _entries(stage: Stage, kind: str) -> list[dict[str, Any]]:
    entries = stage.get(kind)
    return [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []


def _upstream(last: list[str], stages: Mapping[str, Stage]) -> list[str]:
    """Return `last` and all stages whose outputs they are made of, each after those that need it."""
    order: list[str] = []

    def visit(name: str, on_the_way: frozenset[str]) -> None:
        for dep in _paths(stages[name], "deps"):
            for other, stage in stages.items():
                if (
                    other not in on_the_way
                    and other not in order
                    and any(_meet(dep, out) for out in _paths(stage, "outs"))
                ):
                    visit(other, on_the_way | {other})
        order.append(name)

    for name in last:
        if name not in order:
            visit(name, frozenset(last) | {name})
    return order[::-1]


def _altered(project: Path, stage: Stage) -> Iterator[str]:
    """Yield the outputs that are there with another number of bytes than dvc.lock says."""
    for out in _entries(stage, "outs"):
        path = project / str(out.get("path"))
        if path.exists() and size_of(path) != out.get("size"):
            yield str(out.get("path"))


def _told(name: str, stage: Stage, made: Mapping[str, str], now: Mapping[str, Any], code: CodeHashes) -> dict[str, Any]:
    deps = _paths(stage, "deps")
    inputs = {path: md5 for path, md5 in deps.items() if any(_meet(path, out) for out in made)}
    settings = {key: value for file in mapping(stage.get("params")).values() for key, value in mapping(file).items()}
    changed = {key: at(now, key) for key, value in settings.items() if now and at(now, key) != value}
    return {
        "name": name,
        "cmd": str(stage.get("cmd", "")),
        "settings": settings,
        "settings_now": changed,
        "inputs": inputs,
        "remade": [path for path, md5 in inputs.items() if made.get(path, md5) != md5],
        "code": {path: code.compare(path, md5) for path, md5 in deps.items() if path not in inputs},
        "outputs": _paths(stage, "outs"),
    }


def at(tree: Mapping[str, Any], key: str) -> Any:
    """Return what stands at a dotted key; None where nothing does."""
    value: Any = tree
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value
