"""Import closures: on what a resume key and dvc.yaml's deps rest."""

from pathlib import Path

import pytest

from pipeline.base import provenance as code


def closure(module: str) -> list[str]:
    return [str(path) for path in code.import_closure(module)]


def test_closure_of_a_stage() -> None:
    found = closure("stages.ingest")
    assert found == sorted(found)
    assert {"stages/ingest.py", "pipeline/kitti.py", "pipeline/calibration.py", "pipeline/store.py"} <= set(found)
    assert "pipeline/calibration.py" in found, "imported by kitti, not by the stage"
    assert not any(path.startswith("models/") for path in found)
    assert not {"pipeline/kitti.py", "pipeline/png.py"} & set(closure("stages.labels")), "labels needs no raw drives"


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(code, "ROOT", tmp_path)
    for name, text in {
        "stages/a.py": "from pipeline import b\n\ndef f():\n    import pipeline.d as x\n",
        "pipeline/__init__.py": "",
        "pipeline/b.py": "from pipeline.c import thing\nimport numpy\n",
        "pipeline/c.py": "from pipeline import b  # a circle\nthing = 1\n",
        "pipeline/d/__init__.py": "from .e import y\n",
        "pipeline/d/e.py": "y = 1\n",
        "pipeline/unused.py": "",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_closure_follows_circles_packages_and_imports_in_functions(project: Path) -> None:
    found = closure("stages.a")
    assert {"stages/a.py", "pipeline/b.py", "pipeline/c.py", "pipeline/d/__init__.py"} <= set(found)
    assert "pipeline/unused.py" not in found


def test_fingerprint_changes_with_the_closure_only(project: Path) -> None:
    def fingerprint() -> str:
        code.fingerprint.cache_clear()
        return code.fingerprint("stages.a")

    first = fingerprint()
    (project / "pipeline/unused.py").write_text("changed = True\n")
    assert fingerprint() == first
    (project / "pipeline/c.py").write_text("thing = 2\n")
    assert fingerprint() != first
    code.fingerprint.cache_clear()
