"""Import closures, with which test_dvc_yaml compares dvc.yaml."""

from pathlib import Path

import pytest

from tests import imports


def closure(*modules: str) -> set[str]:
    paths = imports.import_closure(*modules)
    assert paths == sorted(paths)
    return {str(path) for path in paths}


def test_closure_of_a_stage() -> None:
    paths = closure("stages.ingest")
    assert {"stages/ingest.py", "pipeline/kitti/raw.py", "pipeline/base/store.py", "pipeline/base/atomic.py"} <= paths
    assert "pipeline/kitti/calibration.py" in paths, "imported by raw, not by the stage"
    assert "pipeline/kitti/__init__.py" in paths
    assert not any(path.startswith("models/") for path in paths)
    assert not {"pipeline/kitti/raw.py", "pipeline/camera/images.py"} & closure("stages.labels"), (
        "labels needs no raw drives"
    )


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(imports, "ROOT", tmp_path)
    for name, text in {
        "stages/a.py": "from pipeline.base import store\n\ndef f():\n    import pipeline.room.deep.d as x\n",
        "stages/b.py": "import importlib\nfrom typing import Any\nimport torch\n",
        "stages/types.py": """
import typing
from typing import TYPE_CHECKING
if TYPE_CHECKING:
    from pipeline.room import only_types
    from models.steering.spatial import gnn
elif True:
    import pipeline.room.otherwise
if typing.TYPE_CHECKING:
    import pipeline.unused
else:
    def f():
        if not TYPE_CHECKING:
            from models.steering.spatial import cnn
""",
        "pipeline/__init__.py": "",
        "pipeline/base/__init__.py": "",
        "pipeline/base/store.py": "from pipeline.base.errors import thing\nimport numpy\n",
        "pipeline/base/errors.py": "from pipeline.base import store  # a circle\nthing = 1\n",
        "pipeline/room/__init__.py": "from . import sibling\n",
        "pipeline/room/sibling.py": "",
        "pipeline/room/otherwise.py": "",
        "pipeline/room/only_types.py": "",
        "pipeline/room/deep/__init__.py": "",
        "pipeline/room/deep/d.py": "from .e import y\nfrom ..up import z\nfrom ...top import t\n",
        "pipeline/room/deep/e.py": "y = 1\n",
        "pipeline/room/up.py": "z = 1\n",
        "pipeline/top.py": "t = 1\n",
        "pipeline/unused.py": "",
        "models/steering/spatial/gnn.py": "from models.steering.spatial.cnn import x\n",
        "models/steering/spatial/cnn.py": "x = 1\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.usefixtures("project")
def test_closure_follows_cycles_packages_and_imports_in_functions() -> None:
    base = {"pipeline/__init__.py", "pipeline/base/__init__.py", "pipeline/base/store.py", "pipeline/base/errors.py"}
    assert closure("pipeline.base.store") == base
    deep = {"deep/__init__.py", "deep/d.py", "deep/e.py", "up.py", "__init__.py", "sibling.py"}
    assert closure("stages.a") == {
        *base, "stages/a.py", "pipeline/top.py", *(f"pipeline/room/{name}" for name in deep)
    }  # fmt: skip


@pytest.mark.usefixtures("project")
def test_imports_for_types_alone_do_not_count() -> None:
    assert closure("stages.types") == {
        "stages/types.py", "pipeline/__init__.py", "pipeline/room/__init__.py", "pipeline/room/sibling.py",
        "pipeline/room/otherwise.py", "models/steering/spatial/cnn.py",
    }  # fmt: skip


@pytest.mark.usefixtures("project")
def test_what_is_imported_by_a_computed_name_is_given() -> None:
    assert closure("stages.b", "models.steering.spatial.gnn") == {
        "stages/b.py", "models/steering/spatial/gnn.py", "models/steering/spatial/cnn.py"
    }  # fmt: skip
    assert closure("numpy") == set()
