"""params.yaml: what is right is read, what is wrong is named."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline.base import params
from pipeline.base.errors import InputError
from pipeline.sections.clouds import Clouds
from pipeline.sections.graphs import Variant
from pipeline.sections.ingest import Ingest
from pipeline.sections.labels import Labels
from pipeline.sections.models import Model
from pipeline.sections.train import Train
from stages import check

ROOT = Path(__file__).resolve().parents[3]


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


def test_a_stage_needs_only_its_own_sections(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_text("labels: {wheelbase_m: 2.7, min_speed_mps: 1, standstill: raw}\n")
    assert params.load(Labels, path).min_speed_mps == 1.0
    with pytest.raises(InputError, match="has no section 'clouds'"):
        params.load(Clouds, path)


def test_splits_keep_their_order(tmp_path: Path) -> None:
    drives = {"train": ["2011_09_26_drive_0009", "2011_09_26_drive_0001"], "val": [], "test": ["2011_09_26_drive_0002"]}
    splits = params.load(Ingest, edited(tmp_path, "ingest.drives", drives)).drives.splits()
    assert list(splits.items()) == [
        ("2011_09_26_drive_0009", "train"),
        ("2011_09_26_drive_0001", "train"),
        ("2011_09_26_drive_0002", "test"),
    ]


def test_a_range_names_all_its_drives(tmp_path: Path) -> None:
    drives = {
        "train": ["2026_01_04_drive_0008..0010", "2011_09_26_drive_0001"],
        "test": ["2026_01_03_drive_0001..0001"],
    }
    read = params.load(Ingest, edited(tmp_path, "ingest.drives", drives)).drives
    assert read.train == [*(f"2026_01_04_drive_{number:04d}" for number in (8, 9, 10)), "2011_09_26_drive_0001"]
    assert read.test == ["2026_01_03_drive_0001"]


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("labels.min_speed_mps", -1, r"labels.min_speed_mps = -1: Input should be greater than or equal to 0"),
        ("labels.min_speed_mps", "fast", r"labels.min_speed_mps = 'fast': Input should be a valid number"),
        ("labels.min_speed_mps", float("nan"), r"labels.min_speed_mps = nan: Input should be a finite number"),
        ("labels.wheelbase_m", 0, r"labels.wheelbase_m = 0: Input should be greater than 0"),
        ("labels.standstill", "drop", r"labels.standstill = 'drop': Input should be 'invalid', 'raw' or 'zero'"),
        ("labels.minspeed_mps", 1, r"unknown key labels.minspeed_mps: did you mean min_speed_mps\?"),
        ("labels.min_speed_mps", None, r"labels.min_speed_mps is missing"),
        ("labels", None, r"has no section 'labels'"),
        ("label", {}, r"unknown section 'label': did you mean labels\?"),
        ("ingest.source", "nuscenes", r"ingest.source = 'nuscenes': Input should be 'town', 'kitti' or 'both'"),
        ("ingest.image_size", [96], r"ingest.image_size.* Field required|ingest.image_size.*missing"),
        ("ingest.image_size", [96, 8], r"ingest.image_size.1 = 8: Input should be greater than or equal to 32"),
        ("ingest.cameras", [], r"ingest.cameras = \[\]: List should have at least 1 item"),
        ("ingest.cameras", [4], r"ingest.cameras.0 = 4: Input should be less than or equal to 3"),
        ("ingest.drives.train", [], r"ingest.drives.train = \[\]: List should have at least 1 item"),
        ("ingest.drives.test", ["0001"], r"ingest.drives.test.0 = '0001': String should match"),
        ("ingest.drives.val", ["2026_01_03_drive_0001"], r"2026_01_03_drive_0001 is named twice"),
        ("ingest.drives.val", ["2026_01_03_drive_0000..0002"], r"drive_0001, 2026_01_03_drive_0002 is named twice"),
        ("ingest.drives.val", ["2026_01_09_drive_0003..0002"], r"0003\.\.0002 names no drive: 0002 comes before 0003"),
        ("ingest.drives.val", ["2026_13_09_drive_0001..0002"], r"'2026_13_09_drive_0001': String should match"),
        ("ingest.drives.val", "2026_01_09_drive_0001", r"Input should be a valid list"),
        ("ingest.drives.val", [7], r"ingest.drives.val.0 = 7: Input should be a valid string"),
        ("train.seeds", [0, 0], r"train.seeds = \[0, 0\]: a seed is named twice"),
        ("train.epochs", 0, r"train.epochs = 0: Input should be greater than or equal to 1"),
        ("train.epochs", 1.5, r"train.epochs = 1.5: Input should be a valid integer"),
        ("graphs", {}, r"section 'graphs' is missing or empty"),
        ("graphs.semantic.keep_inter_class", 1.2, r"graphs.semantic.keep_inter_class = 1.2: .*less than or equal to 1"),
        ("graphs.semantic.source", "radar", r"graphs.semantic.source = 'radar': Input should be"),
        ("graphs.semantic.k", None, r"graphs.semantic: k is missing for a kNN graph"),
        (
            "graphs.image.points",
            9,
            r"graphs.image: points is not an option of images.*options: source\)$",
        ),
        (
            "graphs.lidar-pointnet2.k",
            6,
            r"graphs.lidar-pointnet2: k is not an option of neighbourhood: pointnet2.*centres, .*radius_m",
        ),
        ("graphs.lidar-pointnet2.points", None, r"points is missing for neighbourhood: pointnet2"),
        ("graphs.lidar-pointnet2.centres", [9], r"must have one number for each level"),
        ("graphs.lidar-pointnet2.radius_m", [0, 1], r"graphs.lidar-pointnet2.radius_m.0 = 0: .*greater than 0"),
        ("graphs.semantic.centres", [9], r"graphs.semantic: centres is not an option of a kNN graph.*keep_inter_class"),
        ("models.sa-gnn-ncp.window", 0, r"models.sa-gnn-ncp.window = 0: .*greater than or equal to 1"),
        ("models.sa-gnn-ncp.input", "semantics", r"models.sa-gnn-ncp.input = 'semantics' .*did you mean semantic\?"),
        ("models.sa-gnn-ncp.wiring", {"inters": 3}, r"models.sa-gnn-ncp.wiring.inters = 3: .*did you mean inter"),
    ],
)
def test_a_wrong_value_is_named(tmp_path: Path, key: str, value: Any, message: str) -> None:
    path = edited(tmp_path, key, value)
    with pytest.raises(InputError, match=message) as error:
        check.main(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a: [1, 2", "is not valid YAML"),
        (b"town: \xff", "is not valid YAML"),
        (b"", "holds no sections"),
        (b"- 1\n- 2\n", "holds no sections"),
    ],
)
def test_files_that_are_none(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "params.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        params.load(Train, path)
    with pytest.raises(InputError, match="is missing: run from the repository's root"):
        params.load(Train, tmp_path / "nowhere.yaml")


def test_entries_of_mappings() -> None:
    path = ROOT / "params.yaml"
    assert "semantic" in params.names("graphs", path)
    assert params.load_entry(Variant, "graphs", "semantic", path).source == "clouds/pseudo"
    assert params.load_entry(Model, "models", "sa-gnn-ncp", path).semantics == 1.0
    with pytest.raises(InputError, match=r"models has no 'sa-gnn-ncq': did you mean .*sa-gnn-ncp"):
        params.load_entry(Model, "models", "sa-gnn-ncq", path)


@pytest.mark.parametrize("name", ["a", "A-9_b", "50k", "0", "x" * 99])
def test_names_that_dvc_and_shells_take(tmp_path: Path, name: str) -> None:
    path = edited(tmp_path, "graphs", {name: {"source": "clouds/pseudo", "points": 9, "k": 2}})
    assert params.names("graphs", path) == [name]
    assert params.load_entry(Variant, "graphs", name, path).k == 2


@pytest.mark.parametrize(
    "name", ["", ".", "..", "a.b", "a@b", "a b", "a/b", "/a", "-a", "_a", "x;touch pwned", "$(x)", "ä", "a\n", 7, True]
)
@pytest.mark.parametrize("mapping", ["graphs", "models"])
def test_other_names_are_refused(tmp_path: Path, mapping: str, name: Any) -> None:
    original = yaml.safe_load((ROOT / "params.yaml").read_text())[mapping]
    path = edited(tmp_path, mapping, {**original, name: next(iter(original.values()))})
    kind: Any = {"graphs": Variant, "models": Model}[mapping]
    for read in (
        lambda: params.names(mapping, path),
        lambda: params.load_entry(kind, mapping, name, path),
        lambda: check.main(path),
    ):
        with pytest.raises(InputError) as error:
            read()
        for words in (str(path), mapping, repr(name), "letters", "digits, _ and -"):
            assert words in str(error.value)
        assert ("quotes" in str(error.value)) == (not isinstance(name, str))
    assert [path.name for path in tmp_path.iterdir()] == ["params.yaml"]
