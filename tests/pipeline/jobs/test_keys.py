"""Cache keys have what can change a result, and nothing else; edits during a stage are found."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline.jobs import keys
from pipeline.jobs.keys import Code
from pipeline.jobs.outputs import stage_folder

from pipeline.base.errors import InputError
from pipeline.base.params import load_section
from pipeline.labels.settings import Labels
from tests.kitti_drive import contents, write

DATASETS = "pipeline/ingest/datasets"
SPATIAL = "models/steering/spatial"
NCP = "models/steering/temporal/ncp.py"
# Title of a result → its stage, and the files of its networks or of its dataset.
RESULTS = {
    "gnn": ("train", (f"{SPATIAL}/gnn.py", NCP)),
    "cnn": ("train", (f"{SPATIAL}/cnn.py", NCP)),
    "kitti": ("ingest", (f"{DATASETS}/kitti.py",)),
    "sample": ("ingest", (f"{DATASETS}/sample.py",)),
    "folders": ("ingest", (f"{DATASETS}/folders.py",)),
    "perception": ("perception", ()),
    "labels": ("labels", ()),
    "report": ("report", ()),
}
ALL = set(RESULTS)
JOBS = sorted((keys.ROOT / keys.JOBS).glob("*.py"))
INGEST = {"kitti", "sample", "folders"}


def all_keys() -> dict[str, str]:
    keys.LOADED = keys.scan_code()
    return {title: Code.read(stage, chosen).hash() for title, (stage, chosen) in RESULTS.items()}


def changed_keys(before: dict[str, str]) -> set[str]:
    return {title for title, key in all_keys().items() if key != before[title]}


def edit(path: Path, before: str, after: str) -> None:
    """Replace text of a file; without text before, add it to the file's end, or write the file."""
    if not before:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a") as file:
            file.write(after)
        return
    text = path.read_text()
    assert before in text
    write(path, text.replace(before, after, 1))


@pytest.mark.parametrize(
    ("file", "changed"),
    [
        ("pipeline/ingest/write.py", INGEST),
        ("pipeline/base/store.py", ALL),
        ("pipeline/labels/label.py", {"labels", "gnn", "cnn", "report"}),
        ("pipeline/labels/helper/__init__.py", {"labels"}),
        ("pipeline/sample/world.py", set()),
        # A data file.
        ("pipeline/report/page.html.j2", {"report"}),
        # A dataset. The sample is read by kitti.py, so dvc.yaml lists that by name.
        (f"{DATASETS}/kitti.py", INGEST),
        (f"{DATASETS}/sample.py", {"sample"}),
        (f"{DATASETS}/sample.yaml", {"sample"}),
        (f"{DATASETS}/mine.py", set()),
        # A network, with a folder and weights of its own, and another network.
        ("models/steering/core/features.py", {"gnn", "cnn"}),
        (f"{SPATIAL}/gnn.py", {"gnn"}),
        (f"{SPATIAL}/gnn/layers.py", {"gnn"}),
        (f"{SPATIAL}/gnn.pt", {"gnn"}),
        ("models/steering/weights/gnn.pt", {"gnn"}),
        ("models/steering/weights/ncp/a.bin", {"gnn", "cnn"}),
        ("models/steering/weights/mine.pt", set()),
        (f"{SPATIAL}/mine.py", set()),
        # What Python, editors and file managers leave.
        ("pipeline/base/store.py~", set()),
        ("pipeline/base/.DS_Store", set()),
        ("pipeline/base/__pycache__/store.cpython-311.pyc", set()),
        # Files that only run stages and print.
        *((f"pipeline/jobs/{path.name}", set()) for path in JOBS),
    ],
)
def test_a_key_has_the_files_that_can_change_the_result(checkout, file, changed):
    keys_before = all_keys()
    edit(checkout / file, "", "# a comment\n")
    assert changed_keys(keys_before) == changed


@pytest.mark.parametrize(("package", "changed"), [("opencv-python-headless", ALL), ("tqdm", set())])
def test_a_key_has_the_versions_of_packages_that_change_numbers(
    checkout, monkeypatch, package, changed
):
    keys_before = all_keys()
    version = keys.importlib.metadata.version

    def other_version(name: str) -> str:
        if name == package:
            return f"{version(name)}+other"
        return version(name)

    monkeypatch.setattr(keys.importlib.metadata, "version", other_version)
    assert changed_keys(keys_before) == changed


PARAMS = {"labels": {"wheelbase_m": 2.7, "min_speed_mps": 1.0}, "train": {"epochs": 1}}


@pytest.mark.parametrize(
    ("file", "before", "after", "problem"),
    [
        (
            "pipeline/labels/label.py",
            "",
            "# a comment\n",
            "label.py: was edited while stage labels ran. Undo",
        ),
        ("pipeline/sample/world.py", "", "LIMIT = 1\n", ""),
        ("pipeline/jobs/runner.py", "", "# a comment\n", ""),
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
        load_section(Labels, params)
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
