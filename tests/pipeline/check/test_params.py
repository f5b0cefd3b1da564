"""params.yaml: faults name file, key, value and what is expected."""

from functools import partial, reduce
from pathlib import Path
from typing import Any

import pytest
import yaml

from models.steering.core import options
from pipeline.base import params
from pipeline.base.errors import InputError
from pipeline.evaluate.settings import Evaluate
from pipeline.graphs.settings import Variant
from pipeline.ingest.settings import Ingest
from pipeline.train.settings import Train
from stages import preset
from tests.presets import NAMES


def edited(tmp_path: Path, key: str, value: Any) -> Path:
    """Return a copy of params.yaml with one dotted key replaced; value None removes it."""
    content = yaml.safe_load(preset.PARAMS.read_text())
    *outer, name = key.split(".")
    section = reduce(dict.__getitem__, outer, content)
    section[name] = value
    if value is None:
        del section[name]
    path = tmp_path / "params.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_a_range_names_all_its_drives(tmp_path):
    train = ["2026_01_04_drive_0008..0010", "2011_09_26_drive_0001"]
    drives = {"train": train, "test": ["2026_01_03_drive_0001..0001"]}
    read = params.load_section(Ingest, edited(tmp_path, "ingest.drives", drives)).drives
    assert read.train == [
        *(f"2026_01_04_drive_{number:04d}" for number in (8, 9, 10)),
        "2011_09_26_drive_0001",
    ]
    assert read.test == ["2026_01_03_drive_0001"]


def read_train(path: Path) -> Train:
    return params.load_section(Train, path)


def merge(path: Path) -> dict[str, Any]:
    return preset.merge_preset(str(path.with_suffix("")))


@pytest.mark.parametrize(
    ("read", "text", "problem"),
    [
        (read_train, "train: 1\ntrain: 2\n", "invalid YAML.*duplicate key"),
        (read_train, "trian: {}", r"no section 'train': did you mean trian\?"),
        (read_train, "", "expected sections"),
        (
            partial(params.load_section, Evaluate),
            "evaluate: {bootstrap_block_frames: 200}",
            r"unknown key 'bootstrap_block_frames': did you mean bootstrap_block_s\b",
        ),
        (
            partial(params.load_entry, Variant, "graphs", "a"),
            "graphs: {a: {cloud: lidar}}",
            r"graphs\.a",
        ),
        (merge, "models:\n  '*': null\n", "models.*at least 1"),
        (merge, "train:\n  epochs: null\n", r"train\.epochs: Field required"),
    ],
)
def test_a_faulty_file_is_named(tmp_path, read, text, problem):
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(InputError, match=f"mine.yaml.*{problem}"):
        read(tmp_path / "mine.yaml")


@pytest.mark.parametrize("name", ["", "..", "-a", "$(x)", "ä", "a\n", 7])
def test_invalid_names(tmp_path, name):
    with pytest.raises(InputError, match="expected letters"):
        params.load_entry(Variant, "graphs", name, edited(tmp_path, "graphs", {name: {}}))


@pytest.mark.parametrize("name", NAMES)
def test_a_row_and_its_control_differ_in_the_scene_only(name):
    """The row of NAME-blind is NAME."""
    models = preset.Params.model_validate(preset.merge_preset(name)).models
    for key, entry in models.items():
        is_blind = entry.spatial == "blind"
        assert ("blind" in key) == is_blind, key
        row = models[key.removesuffix("-blind")]
        changed: set[str] = set()
        if is_blind:
            changed = {"spatial", *options.load_options("spatial", row.spatial).model_fields}
        assert entry.model_dump(exclude=changed) == row.model_dump(exclude=changed), key


def test_a_star_removes_all_earlier_entries(tmp_path):
    """An entry of the same name does not inherit their settings."""
    model = "{input: semantic, spatial: gnn, temporal: lstm, semantics: 0.5}"
    path = tmp_path / "mine.yaml"
    path.write_text(f"models:\n  sa-gnn-ncp: {model}\n  '*': null\n")
    assert preset.merge_preset(str(path.with_suffix("")))["models"] == {
        "sa-gnn-ncp": yaml.safe_load(model)
    }
