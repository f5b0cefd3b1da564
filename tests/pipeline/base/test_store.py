"""HDF5 files: round trip, equal bytes, full disks, files from elsewhere."""

import errno
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import hdf5plugin
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
        file.append("cls", np.full((3, 8, 9), 7, np.uint8), "trainId")
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
        assert (file["cls"] == 7).all()
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


def to_link(file: h5py.File, elsewhere: Path) -> None:
    file["image"] = h5py.ExternalLink(elsewhere, "image")


def to_soft_link(file: h5py.File, elsewhere: Path) -> None:
    file["image"] = h5py.SoftLink("/cls")


def to_external_storage(file: h5py.File, elsewhere: Path) -> None:
    file.create_dataset("image", (16,), np.uint8, external=[(elsewhere, 0, h5py.h5f.UNLIMITED)])


def to_virtual(file: h5py.File, elsewhere: Path) -> None:
    layout = h5py.VirtualLayout((3, 8, 9, 3), np.uint8)
    layout[:] = h5py.VirtualSource(elsewhere, "image", (3, 8, 9, 3))
    file.create_virtual_dataset("image", layout)


def to_other_filter(file: h5py.File, elsewhere: Path) -> None:
    file.create_dataset("image", data=np.zeros((3, 8, 9, 3), np.uint8), **hdf5plugin.Blosc2())


@pytest.mark.parametrize("change", [to_link, to_soft_link, to_external_storage, to_virtual, to_other_filter])
def test_a_file_from_elsewhere_opens_no_other_file_and_runs_no_filter_of_others(
    tmp_path: Path, change: Callable[[h5py.File, Path], None]
) -> None:
    path = write(tmp_path / "a.h5")
    DriveReader(path, stage="clouds").__exit__()
    with h5py.File(path, "r+") as file:
        del file["image"]
        change(file, write(tmp_path / "elsewhere.h5"))
    with pytest.raises(InputError, match=r"'image' (is a link|has external storage or a filter)") as raised:
        DriveReader(path, stage="clouds")
    assert raised.value.where == str(path)


def test_files_of_other_stages_schemas_and_drives_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.h5")
    for stage, file, problem in [
        ("ingest", path, "expected stage 'ingest', schema 4; got stage 'clouds', schema 4"),
        ("clouds", tmp_path / "b.h5", "missing"),
        ("clouds", write(tmp_path / "2011_09_26_drive_0002.h5"), f"contains drive {DRIVE}"),
        ("clouds", tmp_path / "foreign.h5", "got stage 'None', schema None"),
        ("clouds", tmp_path / "old.h5", "got stage 'clouds', schema 3"),
        ("clouds", tmp_path / "half.h5", "damaged"),
    ]:
        (tmp_path / "half.h5").write_bytes(path.read_bytes()[:1000])
        if file.stem in ("foreign", "old"):
            with h5py.File(file, "w") as made:
                made.attrs.update({"stage": "clouds", "schema": 3} if file.stem == "old" else {})
        with pytest.raises(InputError, match=problem) as raised:
            DriveReader(file, stage=stage)
        assert raised.value.where == str(file)
        assert f"dvc repro {stage}" in raised.value.fix


def test_index_round_trip(tmp_path: Path) -> None:
    splits = {"b": "train", "a": "test", "c": "train"}
    for drive in splits:
        write(tmp_path / f"{drive}.h5")
    store.write_index(tmp_path, splits)
    assert list(store.read_index(tmp_path, stage="clouds").items()) == list(splits.items())  # in their order
    assert store.drives_in(splits, "train") == ["b", "c"]
    assert store.drives_in(splits, "val", "test") == ["a"]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ('{"drives": {"c": "train"}}', "no file for c"),
        ('{"drives": ', "damaged"),
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
