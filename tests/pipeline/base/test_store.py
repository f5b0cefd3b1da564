"""HDF5 files: round trip, equal bytes, damage, full disks."""

import errno
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader, DriveWriter

DRIVE = "2011_09_26_drive_0001"


def write(path: Path, seed: int = 0, stage: str = "clouds") -> Path:
    rng = np.random.default_rng(seed)
    counts = [5000, 0, 9000]
    with DriveWriter(path, stage=stage, drive=DRIVE, params={"clouds": {"seed": seed}}) as file:
        file.attrs["split"] = "train"
        file.put("frame", np.array([0, 2, 3], np.int32))
        file.put("time_s", np.array([0.0, 0.2, 0.3]), "s")
        file.put("image", rng.integers(0, 256, (3, 8, 9, 3), np.uint8), "RGB")
        file.blank("cls", (3, 8, 9), np.uint8, value=255)
        file.fill("cls", 1, np.full((8, 9), 7, np.uint8))
        for count in counts:
            file.append("xyz", rng.normal(size=(count, 3)).astype(np.float32), "m", "ptr")
            file.append("nearest", np.arange(count, dtype=np.int32), "row", "ptr", refers_to="xyz")
        file.put_pointers("ptr", counts)
    return path


def test_round_trip(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (3, 8, 9, 3), np.uint8)
    xyz = [rng.normal(size=(count, 3)).astype(np.float32) for count in (5000, 0, 9000)]
    with DriveReader(write(tmp_path / "a.h5"), stage="clouds") as file:
        assert (file.drive, file.attrs["split"], file.attrs["schema"]) == (DRIVE, "train", store.SCHEMA)
        assert file.attrs["params"] == '{"clouds": {"seed": 0}}'
        np.testing.assert_array_equal(file.frame, [0, 2, 3])
        np.testing.assert_array_equal(file.time_s, [0, 0.2, 0.3])
        np.testing.assert_array_equal(file["image"], image)
        np.testing.assert_array_equal(file.row("image", 2), image[2])
        np.testing.assert_array_equal(file["ptr"], [0, 5000, 5000, 14000])
        assert file.pointers == {"xyz": "ptr", "nearest": "ptr"}
        assert file.refers_to == {"nearest": "xyz"}
        for row, points in enumerate(xyz):
            np.testing.assert_array_equal(file.rows_of("xyz", row), points)
        assert [np.unique(file.row("cls", i)).tolist() for i in range(3)] == [[255], [7], [255]]
        assert file.dataset("xyz").attrs["unit"] == "m"
        assert "depth" not in file
        assert [file.row_of(number) for number in (0, 2, 3)] == [0, 1, 2]
        with pytest.raises(InputError, match="no frame 1"):
            file.row_of(1)
        with pytest.raises(InputError, match=r"no dataset 'depth'.*cls, frame"):
            file["depth"]


def test_two_writes_are_byte_identical(tmp_path: Path) -> None:
    first, second, other = (write(tmp_path / f"{i}.h5", seed).read_bytes() for i, seed in enumerate([0, 0, 1]))
    assert first == second
    assert first != other


def test_an_error_leaves_nothing_new_and_nothing_broken(tmp_path: Path) -> None:
    before = write(tmp_path / "a.h5").read_bytes()
    with pytest.raises(ZeroDivisionError), DriveWriter(tmp_path / "a.h5", stage="x", drive=DRIVE, params={}) as file:  # noqa: PT012
        file.put("frame", np.arange(1000))
        raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]
    assert (tmp_path / "a.h5").read_bytes() == before


@contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """Let this process write no file beyond `size` bytes: the system refuses, as with a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_is_reported_instead_of_its_consequences(tmp_path: Path) -> None:
    """HDF5 drops errors or raises its own, depending on when the disk is full."""
    rng = np.random.default_rng(0)
    for size in range(1000, 25_000, 2000):
        with (  # noqa: PT012
            pytest.raises(OSError, match=str(tmp_path / "a.h5")) as error,
            files_up_to(size),
            DriveWriter(tmp_path / "a.h5", stage="ingest", drive=DRIVE, params={}) as file,
        ):
            for _ in range(100):
                file.append("lidar", rng.random((100, 4), np.float32))
        assert error.value.errno == errno.EFBIG
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("damage", [lambda chunk: bytes(len(chunk)), lambda chunk: chunk[:-9] + b"\x99" + chunk[-8:]])
def test_damage_is_reported_with_file_and_dataset(tmp_path: Path, damage: Callable[..., bytes]) -> None:
    path = write(tmp_path / "a.h5")
    with h5py.File(path) as file:
        where = file["image"].id.get_chunk_info(1)
    content = bytearray(path.read_bytes())
    chunk = slice(where.byte_offset, where.byte_offset + where.size)
    content[chunk] = damage(bytes(content[chunk]))
    path.write_bytes(content)
    with DriveReader(path, stage="clouds") as file:
        file.row("image", 0)
        for read in (lambda: file["image"], lambda: file.row("image", 1), lambda: file.rows("image", 0, 2)):
            with pytest.raises(InputError, match="damaged in dataset 'image'") as raised:
                read()
            assert raised.value.where == str(path)
            assert "dvc repro --force --single-item clouds" in raised.value.fix


def test_files_of_other_stages_and_schemas_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.h5")
    with pytest.raises(InputError, match="expected stage 'ingest', schema 3; got stage 'clouds'") as raised:
        DriveReader(path, stage="ingest")
    assert "dvc repro ingest" in raised.value.fix
    with h5py.File(path, "r+") as file:
        file.attrs["schema"] = 1
    with pytest.raises(InputError, match="schema 1"):
        DriveReader(path, stage="clouds")
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(InputError, match="damaged"):
        DriveReader(path, stage="clouds")
    with pytest.raises(InputError, match="missing") as raised:
        DriveReader(tmp_path / "b.h5", stage="clouds")
    assert "dvc repro clouds" in raised.value.fix
    with h5py.File(tmp_path / "foreign.h5", "w"):
        pass
    with pytest.raises(InputError, match="got stage 'None', schema None"):
        DriveReader(tmp_path / "foreign.h5", stage="clouds")
    other = write(tmp_path / "2011_09_26_drive_0002.h5")
    with pytest.raises(InputError, match=f"contains drive {DRIVE}"):
        DriveReader(other, stage="clouds")


@pytest.mark.parametrize(
    ("name", "values", "problem"),
    [
        ("frame", np.array([0, 2, 2], np.int32), "increasing"),
        ("time_s", np.array([0.0, 0.2, 0.1]), "increasing"),
        ("time_s", np.array([0.0, 0.2]), "expected 3 rows, got 2"),
        ("xyz", np.zeros((13999, 3), np.float32), "do not fit ptr"),
        ("K", np.eye(4), r"expected shape \(3, 3\)"),
    ],
)
def test_unexpected_contents_are_refused(tmp_path: Path, name: str, values: object, problem: str) -> None:
    path = write(tmp_path / "a.h5")
    with h5py.File(path, "r+") as file:
        attributes = dict(file[name].attrs) if name in file else {}
        if name in file:
            del file[name]
        file[name] = values
        file[name].attrs.update(attributes)
    with DriveReader(path, stage="clouds") as file, pytest.raises(InputError, match=problem) as raised:
        file[name]
    assert raised.value.where == str(path)


@pytest.mark.parametrize(
    ("pointer", "problem"),
    [
        (None, "expected 3 rows, got 14000, and no attribute pointer"),  # as files before this attribute
        (np.bytes_(b"cls"), "damaged in dataset .cls"),
        (np.bytes_(b"xyz"), "its pointers xyz declare pointers"),
        (np.bytes_(b"nothing"), "no dataset 'nothing'"),
        (7, "damaged"),
    ],
)
def test_pointers_that_a_file_does_not_declare_are_refused(tmp_path: Path, pointer: object, problem: str) -> None:
    path = write(tmp_path / "a.h5")
    with h5py.File(path, "r+") as file:
        del file["xyz"].attrs["pointer"]
        if pointer is not None:
            file["xyz"].attrs["pointer"] = pointer
    with DriveReader(path, stage="clouds") as reader, pytest.raises(InputError, match=problem) as raised:
        reader.rows_of("xyz", 0)
    assert raised.value.where == str(path)


def test_index_round_trip(tmp_path: Path) -> None:
    splits = {"b": "train", "a": "test", "c": "train"}
    for drive in splits:
        write(tmp_path / f"{drive}.h5")
    store.write_index(tmp_path, splits)
    assert list(store.read_index(tmp_path, stage="clouds").items()) == list(splits.items())  # in their order
    assert store.indexed(tmp_path) == list(splits)
    assert store.drives_in(splits, "train") == ["b", "c"]
    assert store.drives_in(splits, "val", "test") == ["a"]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ('{"schema": 3, "drives": {"c": "train"}}', "no file for c"),
        ('{"schema": 0, "drives": {}}', "expected schema 3, got 0"),
        ('{"schema": 3, "drives": {"../a": "train"}}', "expected drives with a split"),
        ('{"schema": 3, ', "invalid JSON"),
        (None, "missing"),
    ],
)
def test_faults_of_an_index(tmp_path: Path, content: str | None, problem: str) -> None:
    if content is not None:
        (tmp_path / "index.json").write_text(content)
    with pytest.raises(InputError, match=problem) as raised:
        store.read_index(tmp_path, stage="clouds")
    assert str(tmp_path) in raised.value.where
    assert "clouds" in raised.value.fix


def test_a_huge_index_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with (tmp_path / "index.json").open("wb") as file:
        file.truncate(1 << 40)  # sparse
    with pytest.raises(InputError, match="too large"):
        store.read_index(tmp_path, stage="clouds")
    assert store.indexed(tmp_path) == []
