"""HDF5 files, indexes and hashes: a file is complete or absent, and a damaged one is refused."""

import errno
import fcntl
import json
import resource
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin
import numpy as np
import pytest

from pipeline.base import hashes, store
from pipeline.base.errors import InputError
from pipeline.clouds.cloud_file import create_clouds, open_clouds
from pipeline.graphs.graph_file import open_graphs
from pipeline.ingest.ingest_file import create_ingest, open_ingest
from pipeline.labels.label_file import create_labels
from pipeline.perception.perception_file import create_perception
from steer.artefact import FORMATS, open_drive
from tests import artefacts
from tests.artefacts import write_index
from tests.kitti_drive import contents
from tests.kitti_drive import write as write_text

DRIVE = "2011_09_26_drive_0001"
# Numbers of points of the three frames in the file of write().
COUNTS = (5000, 0, 9000)
IMAGE = np.random.default_rng(0).integers(0, 256, (3, 8, 9, 3), np.uint8)
XYZ = [np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32) for count in COUNTS]


def write(path: Path) -> Path:
    with create_clouds(path, drive=DRIVE, params={"clouds": {"seed": 0}}) as file:
        file.attrs["split"] = "train"
        file.put("frame", np.array([0, 2, 3], np.int32))
        file.put("time_s", np.array([0.0, 0.2, 0.3]), "s")
        file.put("image", IMAGE, "RGB")
        file.append("cls", np.full((3, 8, 9), 7, np.uint8), "trainId")
        for xyz in XYZ:
            nearest = np.arange(len(xyz), dtype=np.int32)
            file.append("xyz", xyz, "m", "ptr")
            file.append("nearest", nearest, "row", "ptr")
        file.put_pointers("ptr", COUNTS)
    return path


def test_round_trip(tmp_path):
    with open_clouds(write(tmp_path / "a.h5")) as file:
        assert file.drive == DRIVE
        assert file.attrs["split"] == "train"
        assert file.params == {"clouds": {"seed": 0}}
        np.testing.assert_array_equal(file.time_s, [0, 0.2, 0.3])
        np.testing.assert_array_equal(file["image"], IMAGE)
        np.testing.assert_array_equal(file.row("image", 2), IMAGE[2])
        np.testing.assert_array_equal(file["ptr"], [0, 5000, 5000, 14000])
        assert file.pointers == {"xyz": "ptr", "nearest": "ptr"}
        for row, points in enumerate(XYZ):
            np.testing.assert_array_equal(file.rows_of("xyz", row), points)
        assert (file["cls"] == 7).all()
        assert file.units["xyz"] == "m"
        assert [file.row_of(number) for number in (0, 2, 3)] == [0, 1, 2]
        with pytest.raises(InputError, match="no frame 1"):
            file.row_of(1)
        with pytest.raises(InputError, match=r"no dataset 'depth'.*cls, frame"):
            file["depth"]


def test_two_writes_are_byte_identical_and_an_error_changes_nothing(tmp_path):
    path = write(tmp_path / "a.h5")
    before = path.read_bytes()
    assert write(tmp_path / "b.h5").read_bytes() == before
    with (  # noqa: PT012
        pytest.raises(ZeroDivisionError),
        create_labels(path, drive=DRIVE, params={}) as file,
    ):
        file.put("frame", np.arange(1000))
        raise ZeroDivisionError
    assert contents(tmp_path) == dict.fromkeys(("a.h5", "b.h5"), before)


@contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """Let the system refuse files beyond `size` bytes by this process, as with a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_is_reported_instead_of_its_consequences(tmp_path):
    """HDF5 drops errors or raises its own, depending on when the disk is full."""
    rng = np.random.default_rng(0)
    for size in range(1000, 25_000, 2000):
        with (  # noqa: PT012
            pytest.raises(OSError, match=str(tmp_path / "a.h5")) as error,
            files_up_to(size),
            create_ingest(tmp_path / "a.h5", drive=DRIVE, params={}) as file,
        ):
            for _ in range(100):
                file.append("lidar", rng.random((100, 4), np.float32))
        assert error.value.errno == errno.EFBIG
    assert not list(tmp_path.iterdir())


def to_virtual(file: h5py.File, elsewhere: Path) -> None:
    layout = h5py.VirtualLayout((3, 8, 9, 3), np.uint8)
    layout[:] = h5py.VirtualSource(elsewhere, "image", (3, 8, 9, 3))
    file.create_virtual_dataset("image", layout)


def to_link(file: h5py.File, elsewhere: Path) -> None:
    file["image"] = h5py.ExternalLink(elsewhere, "image")


def to_external(file: h5py.File, elsewhere: Path) -> None:
    storage = [(elsewhere, 0, h5py.h5f.UNLIMITED)]
    file.create_dataset("image", (16,), np.uint8, external=storage)


def to_other_filter(file: h5py.File, _: Path) -> None:
    file.create_dataset("image", data=IMAGE, **hdf5plugin.Blosc2())


@pytest.mark.parametrize("change", [to_virtual, to_link, to_external, to_other_filter])
def test_a_file_from_elsewhere_opens_no_other_file_and_runs_no_filter_of_others(tmp_path, change):
    path = write(tmp_path / "a.h5")
    with h5py.File(path, "r+") as file:
        del file["image"]
        change(file, write(tmp_path / "elsewhere.h5"))
    problem = "'image' (is a link|has external storage or a filter)"
    with pytest.raises(InputError, match=problem) as raised:
        open_clouds(path)
    assert raised.value.where == str(path)


def edit_attributes(path: Path, **attributes: Any) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs.update(attributes)


def add_signs(path: Path, signs: Sequence[int]) -> None:
    with h5py.File(path, "r+") as file:
        file["xyz"].attrs["mirror_signs"] = np.array(signs)


def cut_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:1000])


def in_folder_of_stage(path: Path) -> None:
    path.with_name("index.json").touch()


@pytest.mark.parametrize(
    ("open_file", "change", "problem"),
    [
        (open_ingest, None, "expected a file of stage ingest; got stage clouds"),
        (open_clouds, Path.unlink, "missing"),
        (open_clouds, in_folder_of_stage, f"contains drive {DRIVE}"),
        (open_clouds, partial(edit_attributes, schema=3), "expected schema 7 or 8; got 3"),
        (open_graphs, partial(edit_attributes, stage="graphs", schema=7), "expected schema 8 or 9"),
        (open_clouds, partial(edit_attributes, params="{"), "damaged in its settings"),
        (open_clouds, partial(add_signs, signs=[-1, 1]), "'xyz': expected .* C signs of 1 or -1"),
        (
            open_clouds,
            partial(add_signs, signs=[-1, 0, 1]),
            "'xyz': expected .* C signs of 1 or -1",
        ),
        (open_clouds, cut_short, "damaged"),
    ],
)
def test_files_of_other_stages_schemas_and_drives_are_refused(tmp_path, open_file, change, problem):
    path = write(tmp_path / "a.h5")
    if change:
        change(path)
    with pytest.raises(InputError, match=problem) as raised:
        open_file(path)
    assert raised.value.where == str(path)
    stage = open_file.__name__.removeprefix("open_")
    assert f"dvc repro {stage}" in raised.value.fix


def write_each_stage(folder: Path) -> None:
    """Write a small file of each stage."""
    frame = np.arange(8)
    angles_rad = np.linspace(-0.1, 0.1, 8)
    write(folder / "clouds.h5")
    artefacts.write_recorded(folder / "ingest.h5", frame, oxts=np.ones((8, 30)))
    artefacts.write_motion(folder, "motion", dict.fromkeys(range(8), (8.0, 0.1)))
    artefacts.write_labels(folder / "labels.h5", angles_rad, frame)
    artefacts.write_graphs(folder / "graphs.h5", angles_rad, frame, points=50)
    path = folder / "perception.h5"
    with create_perception(path, drive="drive", params={"batch": 4}) as file:
        # HDF5 keeps more than eight attributes in another structure.
        for number in range(20):
            file.attrs[f"count_{number}"] = number
        file.put("frame", frame.astype(np.int32))
        file.put("time_s", frame / 10, "s")


def read(path: Path) -> dict[str, Any]:
    """Return all values, texts and settings of a file."""
    with open_drive(path) as file:
        content = {name: (file[name].tobytes(), file.units[name]) for name in file.datasets}
        names = {"pointers": file.pointers}
        return content | file.attrs | names | {"params": file.params}


def test_a_wrong_bit_in_a_file_is_never_another_value(tmp_path):
    """Equal values come from unused bytes."""
    rng = np.random.default_rng(0)
    write_each_stage(tmp_path)
    paths = sorted(tmp_path.iterdir())
    assert [path.stem for path in paths] == sorted(file.STAGE for file in FORMATS)
    for path in paths:
        content = path.read_bytes()
        expected = read(path)
        settings = json.dumps(expected["params"], sort_keys=True).encode()
        places = rng.integers(len(content), size=40)
        places[:8] = content.index(settings) + rng.integers(len(settings), size=8)
        refused = 0
        for place in places.tolist():
            damaged = bytearray(content)
            damaged[place] ^= 1 << rng.integers(8)
            path.write_bytes(damaged)
            try:
                assert read(path) == expected
            except InputError:
                refused += 1
        assert refused > len(places) / 2, path.name


def test_reading_needs_no_lock(tmp_path):
    """Some disks have none."""
    path = write(tmp_path / "a.h5")
    with path.open() as descriptor:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        with open_clouds(path) as file:
            assert file.drive == DRIVE


def test_an_index_keeps_its_order_and_names_missing_files(tmp_path):
    splits = {"b": "train", "a": "test", "c": "train"}
    write_index(tmp_path, splits)
    with pytest.raises(InputError, match=r"no file for b, a, c.*dvc repro clouds"):
        store.read_index(tmp_path, stage="clouds")
    for drive in splits:
        write(tmp_path / f"{drive}.h5")
    index = store.read_index(tmp_path, stage="clouds")
    assert [*index.items()] == [*splits.items()]
    assert store.drives_in(splits, "train") == ["b", "c"]


def test_the_hash_of_a_folder_ignores_files_of_file_managers(tmp_path):
    write_text(tmp_path / "1.png", "a")
    expected = hashes.digest({"1.png": hashes.file_hash(tmp_path / "1.png")})
    for name in (".DS_Store", "._1.png"):
        write_text(tmp_path / name, "b")
        assert hashes.content_hash(tmp_path) == expected
    write_text(tmp_path / "2.png", "a")
    assert hashes.content_hash(tmp_path) != expected
