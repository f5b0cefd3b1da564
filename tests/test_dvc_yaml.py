"""dvc.yaml says of each stage what its code says: nothing that it needs is missing, nothing else makes it run again."""

import ast
import re
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml

from pipeline.base import provenance as code
from pipeline.sections.graphs import Variant

CONFIG: dict[str, Any] = yaml.safe_load((code.ROOT / "dvc.yaml").read_text())
STAGES: dict[str, Any] = {name: {**stage, **stage.get("do", {})} for name, stage in CONFIG["stages"].items()}


def test_one_name_four_places() -> None:
    files = {path.stem for path in (code.ROOT / "stages").glob("*.py")} - {"__init__"}
    assert files == set(STAGES)
    for name, stage in STAGES.items():
        assert re.fullmatch(rf"python -m stages\.{name}( \$\{{key\}})?", stage["cmd"])
        for out in _outs(stage):
            # Which images there are, for variants without a cloud, is known once ingest has run.
            own = "ingest" if out == "data/clouds/none" else out.split("/")[1]
            assert re.fullmatch(r"data/\w+(/\$\{key\}|/pseudo|/lidar|/none|/table\.(md|csv))?", out)
            assert own == name


@pytest.mark.parametrize("name", STAGES)
def test_deps_on_code_are_the_modules_that_the_stage_imports(name: str) -> None:
    imported = {str(path) for path in code.import_closure(f"stages.{name}") if not _is_empty(path)}
    listed = {dep for dep in STAGES[name]["deps"] if dep.endswith(".py")}
    assert listed == imported


@pytest.mark.parametrize("name", STAGES)
def test_deps_on_data_are_exactly_outs(name: str) -> None:
    """Decision 2: a dep on a folder that merely holds outs trains on nothing. Report, which gathers, may.

    It also reads one small file of stage perception, so that a machine that reports needs no more of it.
    """
    outs = {out for stage in STAGES.values() for out in _outs(stage)}
    for dep in STAGES[name]["deps"]:
        own = {"report": {"data/evaluate", "data/perception/metrics.json"}}
        if dep.startswith("data/") and dep not in own.get(name, set()):
            pattern = re.sub(r"\$\{item\.\w+\}", "${key}", dep)
            clouds = {f"data/clouds/{cloud}" for cloud in get_args(Variant.model_fields["cloud"].annotation)}
            assert pattern in outs or (dep == "data/clouds/${item.cloud}" and clouds <= outs)


@pytest.mark.parametrize("name", STAGES)
def test_sections_that_a_stage_reads_are_its_params(name: str) -> None:
    tree = ast.parse((code.ROOT / "stages" / f"{name}.py").read_text())
    modules = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    read = {module.removeprefix("pipeline.sections.") for module in modules if module.startswith("pipeline.sections.")}
    listed = {param.split(".")[0] for param in STAGES[name].get("params", [])}
    # check depends on the whole file; evaluate reads a model's line from its checkpoint; report reads only names.
    own = {"check": set(), "evaluate": read - {"models"}, "report": {"models"}}
    assert listed == own.get(name, read)


def test_check_runs_for_any_edit_of_the_params() -> None:
    assert "params.yaml" in STAGES["check"]["deps"]


def _outs(stage: dict[str, Any]) -> list[str]:
    return [next(iter(out)) if isinstance(out, dict) else out for out in stage.get("outs", [])]


def _is_empty(path: Path) -> bool:
    """A package's __init__.py that only names it."""
    return path.name == "__init__.py" and len(ast.parse((code.ROOT / path).read_text()).body) <= 1
