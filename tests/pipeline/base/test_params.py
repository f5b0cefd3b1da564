"""Reading params.yaml: values, and faults with file, key, value and what is expected."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline.base import params
from pipeline.base.errors import InputError
from pipeline.base.resume import ROOT
from pipeline.settings.clouds import Clouds
from pipeline.settings.graphs import Variant
from pipeline.settings.ingest import Ingest
from pipeline.settings.labels import Labels
from pipeline.settings.train import Train


def edited(tmp_path: Path, key: str, value: Any) -> Path:
    """Return a copy of params.yaml with one dotted key replaced; value None removes it."""
    content = yaml.safe_load((ROOT / "params.yaml").read_text())
    *outer, last = key.split(".")
    section = content
    for name in outer:
        section = section[name]
    if value is None:
        del section[last]
    else:
        section[last] = value
    path = tmp_path / "params.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_a_stage_reads_only_its_own_sections(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_text("labels: {wheelbase_m: 2.7, min_speed_mps: 1, source: oxts}\n")
    assert params.load(Labels, path).min_speed_mps == 1.0
    with pytest.raises(InputError, match="no section 'clouds'"):
        params.load(Clouds, path)


def test_a_range_names_all_its_drives(tmp_path: Path) -> None:
    drives = {
        "train": ["2026_01_04_drive_0008..0010", "2011_09_26_drive_0001"],
        "test": ["2026_01_03_drive_0001..0001"],
    }
    read = params.load(Ingest, edited(tmp_path, "ingest.drives", drives)).drives
    assert read.train == [*(f"2026_01_04_drive_{number:04d}" for number in (8, 9, 10)), "2011_09_26_drive_0001"]
    assert read.test == ["2026_01_03_drive_0001"]


@pytest.mark.parametrize(
    ("section", "key", "value", "problem"),
    [
        (Labels, "labels.min_speed_mps", "fast", "valid number.*got 'fast'."),
        (Labels, "labels.min_speed_mps", float("nan"), "finite number"),
        (Labels, "labels.minspeed_mps", 1, r"labels: unknown key 'minspeed_mps': did you mean min_speed_mps\?"),
        (Labels, "labels.min_speed_mps", None, "min_speed_mps: Field required. Copy it"),
        (Ingest, "ingest.cameras", [], "at least 1 item"),
        (Ingest, "ingest.drives.test", ["0001"], "expected a drive's name, such as 2011_09_26_drive_0052 .got '0001'"),
        (Train, "train.epochs", 1.5, "valid integer"),
        (Train, "train.epochs", True, "valid integer"),
        (Train, "train.epochs", "5", "valid integer"),
        (Train, "train.learning_rate", True, "valid number"),
        (Train, "train.mirror", 1, "valid boolean"),
        (Ingest, "ingest.drives.tset", [], r"ingest.drives: unknown key 'tset': did you mean test\?"),
        (Ingest, "ingest.image_size", ["96", 320], "valid integer"),
    ],
)
def test_faults_name_file_key_and_value(
    tmp_path: Path, section: type[params.Section], key: str, value: Any, problem: str
) -> None:
    path = edited(tmp_path, key, value)
    with pytest.raises(InputError, match=problem) as raised:
        params.load(section, path)
    assert raised.value.where.startswith(f"{path}: {key.split('.')[0]}")


def test_a_missing_key_that_is_misspelt_is_reported_as_unknown() -> None:
    with pytest.raises(InputError, match="did you mean max_points"):
        params.parse(Clouds, {"max_point": 1, "max_depth_m": 80.0}, "clouds")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"train: 1\ntrain: 2\n", "invalid YAML.*duplicate key"),
        (b"trian: {}", r"no section 'train': did you mean trian\?"),
        (b"", "expected sections"),
        (None, "file is missing"),
    ],
)
def test_faulty_files(tmp_path: Path, content: bytes | None, problem: str) -> None:
    path = tmp_path / "params.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=problem) as raised:
        params.load(Train, path)
    assert raised.value.where.startswith(str(path))


@pytest.mark.parametrize(
    "name",
    ["", "..", "a b", "a/b", "-a", "x;touch pwned", "$(x)", "ä", "a\n", "x" * 300, 7],
)
def test_invalid_names(tmp_path: Path, name: Any) -> None:
    path = edited(tmp_path, "graphs", {name: {}})
    for read in (lambda: params.entries("graphs", path), lambda: params.load_entry(Variant, "graphs", name, path)):
        with pytest.raises(InputError, match="expected at most 100 letters"):
            read()
