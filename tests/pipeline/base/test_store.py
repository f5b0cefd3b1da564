"""HDF5 files: round trip, equal bytes, full disks, files from elsewhere. Output: complete, and nothing else is lost."""

import errno
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import hdf5plugin
import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.outputs import check_free, claim, stage_folder
from pipeline.base.store import DriveReader, DriveWriter, read_json, replacing, write_json
from tests.kitti_drive import contents
from tests.kitti_drive import write as write_text

DRIVE = "2011_09_26_drive_0001"
COUNTS = 5000, 0, 9000
IMAGE = np.random.default_rng(0).integers(0, 256, (3, 8, 9, 3), np.uint8)
XYZ = [np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32) for count in COUNTS]


def write(path: Path) -> Path:
    with DriveWriter(path, stage="clouds", drive=DRIVE, params={"clouds": {"seed": 0}}) as file:
        file.attrs["split"] = "train"
        file.put("frame", np.array([0, 2, 3], np.int32))
        file.put("time_s", np.array([0.0, 0.2, 0.3]), "s")
        file.put("image", IMAGE, "RGB")
        file.append("cls", np.full((3, 8, 9), 7, np.uint8), "trainId")
        for xyz in XYZ:
            file.append("xyz", xyz, "m", "ptr")
            file.append("nearest", np.arange(len(xyz), dtype=np.int32), "row", "ptr", refers_to="xyz")
        file.put_pointers("ptr", COUNTS)
    return path


def test_round_trip(tmp_path):
    with DriveReader(write(tmp_path / "a.h5"), stage="clouds") as file:
        assert (file.drive, file.attrs["split"], file.params) == (DRIVE, "train", {"clouds": {"seed": 0}})
        np.testing.assert_array_equal(file.time_s, [0, 0.2, 0.3])
        np.testing.assert_array_equal(file["image"], IMAGE)
        np.testing.assert_array_equal(file.row("image", 2), IMAGE[2])
        np.testing.assert_array_equal(file["ptr"], [0, 5000, 5000, 14000])
        assert file.pointers == {"xyz": "ptr", "nearest": "ptr"}
        assert file.refers_to == {"nearest": "xyz"}
        for row, points in enumerate(XYZ):
            np.testing.assert_array_equal(file.rows_of("xyz", row), points)
        assert (file["cls"] == 7).all()
        assert file.dataset("xyz").attrs["unit"] == "m"
        assert [file.row_of(number) for number in (0, 2, 3)] == [0, 1, 2]
        with pytest.raises(InputError, match="no frame 1"):
            file.row_of(1)
        with pytest.raises(InputError, match=r"no dataset 'depth'.*cls, frame"):
            file["depth"]


def test_two_writes_are_byte_identical_and_an_error_changes_nothing(tmp_path):
    path = write(tmp_path / "a.h5")
    before = path.read_bytes()
    assert write(tmp_path / "b.h5").read_bytes() == before
    with pytest.raises(ZeroDivisionError), DriveWriter(path, stage="x", drive=DRIVE, params={}) as file:  # noqa: PT012
        file.put("frame", np.arange(1000))
        raise ZeroDivisionError
    assert contents(tmp_path) == dict.fromkeys(("a.h5", "b.h5"), before)


@contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """Let this process write no file beyond `size` bytes: the system refuses, as with a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_is_reported_instead_of_its_consequences(tmp_path):
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


def to_external_storage(file: h5py.File, elsewhere: Path) -> None:
    file.create_dataset("image", (16,), np.uint8, external=[(elsewhere, 0, h5py.h5f.UNLIMITED)])


def to_virtual(file: h5py.File, elsewhere: Path) -> None:
    layout = h5py.VirtualLayout((3, 8, 9, 3), np.uint8)
    layout[:] = h5py.VirtualSource(elsewhere, "image", (3, 8, 9, 3))
    file.create_virtual_dataset("image", layout)


def to_other_filter(file: h5py.File, elsewhere: Path) -> None:
    file.create_dataset("image", data=IMAGE, **hdf5plugin.Blosc2())


@pytest.mark.parametrize("change", [to_link, to_external_storage, to_virtual, to_other_filter])
def test_a_file_from_elsewhere_opens_no_other_file_and_runs_no_filter_of_others(tmp_path, change):
    path = write(tmp_path / "a.h5")
    with h5py.File(path, "r+") as file:
        del file["image"]
        change(file, write(tmp_path / "elsewhere.h5"))
    with pytest.raises(InputError, match=r"'image' (is a link|has external storage or a filter)") as raised:
        DriveReader(path, stage="clouds")
    assert raised.value.where == str(path)


def to_other_schema(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs["schema"] = 3


@pytest.mark.parametrize(
    ("name", "stage", "change", "problem"),
    [
        ("a", "ingest", None, "expected stage 'ingest', schema 4; got stage 'clouds', schema 4"),
        ("a", "clouds", Path.unlink, "missing"),
        ("2011_09_26_drive_0002", "clouds", None, f"contains drive {DRIVE}"),
        ("a", "clouds", to_other_schema, "got stage 'clouds', schema 3"),
        ("a", "clouds", lambda path: path.write_bytes(path.read_bytes()[:1000]), "damaged"),
    ],
)
def test_files_of_other_stages_schemas_and_drives_are_refused(tmp_path, name, stage, change, problem):
    path = write(tmp_path / f"{name}.h5")
    if change:
        change(path)
    with pytest.raises(InputError, match=problem) as raised:
        DriveReader(path, stage=stage)
    assert raised.value.where == str(path)
    assert f"dvc repro {stage}" in raised.value.fix


def test_index_round_trip(tmp_path):
    splits = {"b": "train", "a": "test", "c": "train"}
    store.write_index(tmp_path, splits)
    with pytest.raises(InputError, match=r"no file for b, a, c.*dvc repro clouds"):
        store.read_index(tmp_path, stage="clouds")
    for drive in splits:
        write(tmp_path / f"{drive}.h5")
    assert list(store.read_index(tmp_path, stage="clouds").items()) == list(splits.items())  # in their order
    assert store.drives_in(splits, "train") == ["b", "c"]
    (tmp_path / "index.json").write_text('{"drives": ')
    with pytest.raises(InputError, match="damaged"):
        store.read_index(tmp_path, stage="clouds")


def test_a_file_appears_complete_or_not_at_all(tmp_path):
    path = tmp_path / "new/folder/a.h5"
    for text in ("first", "second"):
        with replacing(path) as tmp:
            tmp.write_text(text)
            assert tmp.suffix == ".h5", "by which some writers choose the format"
            assert path.exists() == (text == "second")
        assert contents(tmp_path) == {"new/folder/a.h5": text.encode()}
    with pytest.raises(ZeroDivisionError), replacing(path) as tmp:  # noqa: PT012
        tmp.write_text("half")
        raise ZeroDivisionError
    assert contents(tmp_path) == {"new/folder/a.h5": b"second"}


def publish(out: Path, *files: str, stage: str = "labels", shared: bool = False) -> None:
    with stage_folder(stage, out, shared=shared) as folder:
        for file in files:
            write_text(folder.new / file, file)


def test_a_stage_replaces_its_files_and_no_others(tmp_path):
    out = tmp_path / "data/labels"
    publish(out, "a.h5", "below/old.h5")
    write_text(out / "a.h5", "earlier")
    write_text(out / "below/own.txt", "foreign")
    publish(out, "a.h5", "b.h5")
    write_text(out / "c.h5", "foreign")
    with pytest.raises(InputError, match="no stage wrote"):
        publish(out, "a.h5", "c.h5")
    with pytest.raises(ZeroDivisionError), stage_folder("labels", out) as folder:  # noqa: PT012
        write_text(folder.new / "b.h5", "half")
        raise ZeroDivisionError
    with stage_folder("labels", out), pytest.raises(InputError, match="another process"), stage_folder("labels", out):
        pass
    publish(out, "a.h5", "b.h5")
    assert read_json(out / "index.json", stage="labels")["files"] == ["a.h5", "b.h5"]
    files = {name: content.decode() for name, content in contents(out).items() if name != "index.json"}
    assert files == {"a.h5": "a.h5", "b.h5": "b.h5", "below/own.txt": "foreign", "c.h5": "foreign"}


def test_an_index_from_elsewhere_deletes_nothing_outside(tmp_path):
    out = tmp_path / "data/labels"
    publish(out, "a.h5")
    write_text(tmp_path / "precious", "foreign")
    files = ["a.h5", "../../precious", str(tmp_path / "precious")]
    write_json(out / "index.json", {"stage": "labels", "entry": "", "files": files})
    publish(out, "b.h5")
    assert contents(out).keys() == {"b.h5", "index.json"}
    assert (tmp_path / "precious").read_text() == "foreign"


@pytest.mark.parametrize(
    ("existing", "stage", "shared", "problem"),
    [
        ({"notes.txt": "foreign"}, "labels", False, "no stage wrote"),
        ({"index.json": '{"stage": "ingest", "entry": "", "files": ["a.h5"]}', "a.h5": "x"}, "labels", False, "labels"),
        ({"index.json": '{"stage": "train", "entry": "b", "files": []}'}, "train@a", False, "train@a"),
        ({"index.json": '{"own": 1}'}, "labels", True, "labels"),
        ({"a.h5": "foreign"}, "report", True, "no stage wrote"),
        ({"page.html": "foreign"}, "report", True, ""),
        ({".DS_Store": "foreign"}, "labels", False, ""),
    ],
)
def test_a_folder_of_others_is_refused(tmp_path, existing, stage, shared, problem):
    out = tmp_path / "data/out"
    for name, content in existing.items():
        write_text(out / name, content)
    before = contents(out)
    if problem:
        with pytest.raises(InputError, match=problem):
            publish(out, "a.h5", stage=stage, shared=shared)
        assert contents(out) == before
    else:
        publish(out, "a.h5", stage=stage, shared=shared)
        assert contents(out).items() > before.items()


@pytest.mark.parametrize(
    ("existing", "expected"),
    [
        ([], "ride"),
        (["ride/poses.txt"], "ride-2"),
        (["ride/poses.txt", "ride-2/.work/other/a.h5"], "ride-3"),
        (["ride/.work/key/a.h5"], "ride"),
        (["ride/.work/key/a.h5", "ride/poses.txt"], "ride-2"),
        (["ride-3/.work/key/a.h5"], "ride-3"),
        (["ride"], "ride-2"),
    ],
)
def test_a_command_takes_the_first_free_folder(tmp_path, monkeypatch, existing, expected):
    monkeypatch.chdir(tmp_path)
    for name in existing:
        write_text(Path("out") / name, "foreign")
    before = contents(tmp_path)
    assert claim(None, "ride", "key") == Path("out") / expected
    named = Path("out/ride")
    if named.exists() and expected != "ride":
        with pytest.raises(InputError, match="Pass another --out"):
            claim(named, "ride", "key")
    else:
        assert claim(named, "ride", "key") == named
    check_free(tmp_path / "new.json")
    assert contents(tmp_path) == before
