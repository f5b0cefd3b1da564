"""Cache keys have what can change a result, and nothing else; edits during a stage are found."""

import os
import pickle
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline.base import resume
from pipeline.base.errors import InputError
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.base.resume import Code
from pipeline.labels.settings import Labels
from tests.kitti_drive import contents, write

DATASETS = "pipeline/ingest/datasets"
SPATIAL = "models/steering/spatial"
NCP = "models/steering/temporal/ncp.py"
# Title of a result → its stage, and the files of its networks or of its dataset.
RESULTS = {
    "gnn": ("train", (f"{SPATIAL}/gnn.py", NCP)),
    "polar": ("train", (f"{SPATIAL}/polar.py", NCP)),
    "kitti": ("ingest", (f"{DATASETS}/kitti.py",)),
    "sample": ("ingest", (f"{DATASETS}/sample.py",)),
    "recording": ("ingest", (f"{DATASETS}/recording.py",)),
    "perception": ("perception", ()),
    "labels": ("labels", ()),
    "report": ("report", ()),
}
ALL = set(RESULTS)
INGEST = {"kitti", "sample", "recording"}


def keys() -> dict[str, str]:
    return {
        title: Code.read(stage, chosen).hash(chosen) for title, (stage, chosen) in RESULTS.items()
    }


def changed_keys(before: dict[str, str]) -> set[str]:
    return {title for title, key in keys().items() if key != before[title]}


def edit(path: Path, before: str, after: str) -> None:
    """Replace text of a file; without text before, add it to the file's end, or write the file."""
    text = ""
    if path.exists():
        text = path.read_text()
    if not before:
        write(path, text + after)
        return
    assert before in text
    write(path, text.replace(before, after, 1))


@pytest.mark.parametrize(
    ("file", "before", "after", "changed"),
    [
        ("pipeline/ingest/ingest_file.py", "", "LIMIT = 1\n", INGEST),
        ("pipeline/ingest/media.py", "", "LIMIT = 1\n", INGEST),
        (f"{DATASETS}/kitti.py", "", "LIMIT = 1\n", {"kitti", "sample"}),
        (f"{DATASETS}/udacity.py", "", "LIMIT = 1\n", set()),
        (f"{DATASETS}/mine.py", "", "LIMIT = 1\n", set()),
        (f"{DATASETS}/lens.yaml", "", "fov: 60\n", {"kitti", "sample", "recording"}),
        ("pipeline/labels/helper/__init__.py", "", "LIMIT = 1\n", {"labels"}),
        ("pipeline/labels/label.py", "", "LIMIT = 1\n", {"labels", "gnn", "polar", "report"}),
        ("models/encoder/words.txt", "", "road", {"perception"}),
        ("pipeline/report/page.html.j2", "", "road", {"report"}),
        (f"{SPATIAL}/gnn.py", "", "LIMIT = 1\n", {"gnn"}),
        (f"{SPATIAL}/mine.py", "", "LIMIT = 1\n", set()),
        ("models/steering/core/features.py", "", "LIMIT = 1\n", {"gnn", "polar"}),
        ("pipeline/base/runner.py", "", "LIMIT = 1\n", ALL),
        ("pipeline/sample/world.py", "", "LIMIT = 1\n", set()),
        # What has no meaning.
        ("pipeline/base/runner.py", '"""Make drives', '"""Make all drives', set()),
        ("pipeline/base/runner.py", "", "# a comment\n", set()),
        ("pipeline/base/runner.py", "(summary, seconds)", "(\n summary, seconds)", set()),
        ("pipeline/base/runner.py~", "", "LIMIT = 1\n", set()),
        ("pipeline/base/.DS_Store", "", "LIMIT = 1\n", set()),
    ],
)
def test_a_key_has_the_code_that_can_change_the_result(checkout, file, before, after, changed):
    keys_before = keys()
    edit(checkout / file, before, after)
    assert changed_keys(keys_before) == changed


@pytest.mark.parametrize(
    ("package", "changed"),
    [
        ("opencv-python-headless", ALL),
        ("transformers", {"perception"}),
        ("av", INGEST),
        ("tqdm", set()),
    ],
)
def test_a_key_has_the_versions_of_packages_that_change_numbers(
    checkout, monkeypatch, package, changed
):
    keys_before = keys()
    version = resume.importlib.metadata.version

    def other_version(name: str) -> str:
        if name == package:
            return f"{version(name)}+other"
        return version(name)

    resume._version.cache_clear()
    monkeypatch.setattr(resume.importlib.metadata, "version", other_version)
    assert changed_keys(keys_before) == changed
    resume._version.cache_clear()


PARAMS = {"labels": {"wheelbase_m": 2.7, "min_speed_mps": 1.0}, "train": {"epochs": 1}}


@pytest.mark.parametrize(
    ("file", "before", "after", "problem"),
    [
        (
            "pipeline/labels/label.py",
            "",
            "LIMIT = 1\n",
            "label.py: was edited while stage labels ran. Undo",
        ),
        ("pipeline/labels/label.py", "", "# a comment\n", ""),
        ("pipeline/sample/world.py", "", "LIMIT = 1\n", ""),
        (
            "params.yaml",
            "2.7",
            "2.8",
            "yaml: labels was edited while stage labels ran. Undo",
        ),
        ("params.yaml", "epochs: 1", "epochs: 2", ""),
    ],
)
def test_an_edit_while_a_stage_runs_is_found_at_its_end(checkout, file, before, after, problem):
    params = checkout / "params.yaml"
    out = checkout / "data/labels"
    params.write_text(yaml.safe_dump(PARAMS))
    text = (checkout / file).read_text()

    def run(*change: Any) -> None:
        load(Labels, params)
        with stage_folder("labels", out, params=params) as folder:
            write(folder.kept / "finished", "")
            folder.used.add(folder.kept / "finished")
            write(folder.new / "a.h5", "new")
            if change:
                edit(checkout / file, *change)

    if not problem:
        run(before, after)
        return
    with pytest.raises(InputError, match=problem):
        run(before, after)
    assert contents(out) == {}
    assert (checkout / "data/.drives/labels/finished").exists()
    (checkout / file).write_text(text)
    run()
    assert "a.h5" in contents(out)


def test_a_worker_compares_the_code_that_it_loaded(checkout, monkeypatch):
    """It starts seconds after its stage, and an edit may have been undone since."""
    path = checkout / "pipeline/labels/label.py"
    code = pickle.loads(pickle.dumps(Code.read("labels")))
    code.check_unedited()
    text = path.read_text()
    edit(path, "", "LIMIT = 1\n")
    loaded = {Path("pipeline/labels/label.py"): resume._stamp(path)}
    for restored in (False, True):
        if restored:
            path.write_text(text)
            os.utime(path, ns=(10**18, 10**18))
        monkeypatch.setattr(resume, "_LOADED", loaded)
        with pytest.raises(InputError, match="was edited while stage labels ran"):
            code.check_unedited()
    monkeypatch.setattr(resume, "_LOADED", {})
    code.check_unedited()
    monkeypatch.setattr(resume, "_LOADED", loaded)
    with pytest.raises(InputError, match="was edited while stage labels ran"):
        Code.read("labels")
