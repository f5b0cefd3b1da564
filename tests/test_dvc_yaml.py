"""dvc.yaml says of each stage what its code says: nothing that it needs is missing, little else makes it run again."""

import ast
import re
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml

from pipeline.base import resume
from pipeline.sections.graphs import Variant
from tests import imports

CONFIG: dict[str, Any] = yaml.safe_load((resume.ROOT / "dvc.yaml").read_text())
STAGES: dict[str, Any] = {name: {**stage, **stage.get("do", {})} for name, stage in CONFIG["stages"].items()}
NETWORKS = {"${item.spatial}": "models/steering/spatial", "${item.temporal}": "models/steering/temporal"}
# What a stage depends on without importing it, because it depends on the room; each is named once.
ROOMS = {"pipeline/base", "pipeline/camera"}  # small and still: what a file is, what a pixel is
BEYOND: dict[str, set[str]] = {
    "check": {"pipeline", "models"},  # it takes seconds, and is to find faults wherever they are
    "town": {"pipeline/kitti/ingest_file.py"},  # the sample is rendered again
    "scores": {"models/encoder"},  # flat ground; other networks make another perception anyway
    # These make another training anyway.
    "evaluate": {
        *(f"pipeline/train/{name}.py" for name in ("training", "fit", "curve", "reading", "augment")),
        "pipeline/fitting",
    },
}


def _files(dep: str) -> set[Path]:
    """Return the source files that a dep covers, without __init__.py that only name a package."""
    for name, folder in NETWORKS.items():
        if name in dep:
            return _files(folder)
    path = resume.ROOT / dep
    assert path.exists(), dep
    files = path.rglob("*.py") if path.is_dir() else {path} - {path.with_suffix(".j2")}  # a template imports nothing
    return {file.relative_to(resume.ROOT) for file in files if not _is_empty(file.relative_to(resume.ROOT))}


def _is_empty(path: Path) -> bool:
    """A package's __init__.py that only names it."""
    return path.name == "__init__.py" and len(ast.parse((resume.ROOT / path).read_text()).body) <= 1


def test_one_name_four_places() -> None:
    files = {path.stem for path in (resume.ROOT / "stages").glob("*.py")} - {"__init__"}
    assert files == set(STAGES)
    for name, stage in STAGES.items():
        argument = r' "\${DVC_STAGE#*@}"' if "foreach" in stage else ""
        assert stage["cmd"] == f"python -m stages.{name}{argument}"
        for out in _outs(stage):
            assert out.split("/")[:2] == ["data", name]


@pytest.mark.parametrize("name", STAGES)
def test_what_a_stage_imports_is_covered_and_little_else(name: str) -> None:
    modules = [f"stages.{name}"]
    if any(network in dep for network in NETWORKS for dep in STAGES[name]["deps"]):
        folders = [*NETWORKS.values(), "models/steering/core/cell"]
        modules += [".".join(file.with_suffix("").parts) for folder in folders for file in _files(folder)]
    imported = {path for path in imports.import_closure(*modules) if not _is_empty(path)}
    covered = {path for dep in _code(name) for path in _files(dep)}
    assert imported <= covered
    for beyond in BEYOND.get(name, set()):
        assert _files(beyond) & (covered - imported), f"{beyond} is no longer beyond {name}"
    assert covered - imported <= {path for dep in BEYOND.get(name, set()) | ROOMS for path in _files(dep)}


def test_a_network_is_a_dependency_by_its_name() -> None:
    for stage in ("train", "evaluate"):
        assert {f"{folder}/{name}.py" for name, folder in NETWORKS.items()} <= set(STAGES[stage]["deps"])
    for folder in NETWORKS.values():
        assert not any(dep == folder for stage in ("train", "evaluate") for dep in STAGES[stage]["deps"])


@pytest.mark.parametrize("network", [file for folder in NETWORKS.values() for file in sorted(_files(folder))], ids=str)
def test_a_network_imports_only_code_that_dvc_tracks_for_it(network: Path) -> None:
    imported = set(imports.import_closure(".".join(network.with_suffix("").parts)))
    tracked = {network, Path("pipeline/camera/classes.py"), *_files("models/steering/core")}
    assert {path for path in imported if not _is_empty(path)} <= tracked


@pytest.mark.parametrize("name", STAGES)
def test_deps_on_data_are_exactly_outs(name: str) -> None:
    """A dep on a folder that merely holds outs trains on nothing. Report, which gathers, may."""
    outs = {out for stage in STAGES.values() for out in _outs(stage)}
    sources = {f"data/{source}" for source in get_args(Variant.model_fields["source"].annotation)}
    for dep in STAGES[name]["deps"]:
        if dep == "data/${item.source}":
            assert sources <= outs
        elif dep.startswith("data/") and (name, dep) not in {("report", "data/evaluate"), ("report", "data/train")}:
            assert re.sub(r"\$\{item\.\w+\}", "${key}", dep) in outs


@pytest.mark.parametrize("name", STAGES)
def test_sections_that_a_stage_reads_are_its_params(name: str) -> None:
    tree = ast.parse((resume.ROOT / "stages" / f"{name}.py").read_text())
    modules = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    read = {module.removeprefix("pipeline.sections.") for module in modules if module.startswith("pipeline.sections.")}
    listed = {param.split(".")[0] for param in STAGES[name].get("params", [])}
    # check depends on the whole file; of models, report reads only names.
    assert listed == {"check": set(), "report": {"models", "evaluate"}}.get(name, read)


def test_check_runs_for_any_edit_of_the_params() -> None:
    assert "params.yaml" in STAGES["check"]["deps"]


def _outs(stage: dict[str, Any]) -> list[str]:
    return [next(iter(out)) if isinstance(out, dict) else out for out in stage.get("outs", [])]


def _code(name: str) -> list[str]:
    return [dep for dep in STAGES[name]["deps"] if not dep.startswith("data/") and dep != "params.yaml"]
