"""Resume keys: everything that determines a result changes them."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.base import resume
from pipeline.base.resume import ROOT, stage_key


def test_stage_settings_and_inputs_are_in_a_key(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_text("1")
    keys = [
        stage_key(stage, settings, inputs)
        for stage in ("labels", "ingest")
        for settings in ({"k": 6}, {"k": 7})
        for inputs in ([file], ["a"], [file, "a"], ["a", file], [])
    ]
    file.write_text("2")
    keys.append(stage_key("labels", {"k": 6}, [file]))
    assert len(set(keys)) == len(keys)


@pytest.fixture
def key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Return a function that computes a stage's key in a copy of the code, as a new process does."""
    for package in resume.PACKAGES:
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copyfile(ROOT / "dvc.yaml", tmp_path / "dvc.yaml")
    monkeypatch.setattr(resume, "ROOT", tmp_path)

    def compute(stage: str) -> str:
        resume._stage_code_hash.cache_clear()
        return stage_key(stage, {}, [])

    return compute


@pytest.mark.parametrize(
    ("file", "stages"),
    [
        ("pipeline/labels/label.py", {"labels", "train"}),
        ("pipeline/base/store.py", {"labels", "clouds", "train"}),
        ("models/steering/spatial/gnn.py", {"train"}),  # a file that dvc.yaml names by ${item.spatial}
        ("pipeline/sample/world.py", set()),
        ("pipeline/base/.store.py.swp", set()),
    ],
)
def test_the_code_that_dvc_yaml_names_is_in_a_key(
    tmp_path: Path, key: Callable[[str], str], file: str, stages: set[str]
) -> None:
    before = {stage: key(stage) for stage in ("labels", "clouds", "train")}
    with (tmp_path / file).open("a") as code:
        code.write("# an edit\n")
    assert {stage for stage in before if key(stage) != before[stage]} == stages
    resume._stage_code_hash.cache_clear()
