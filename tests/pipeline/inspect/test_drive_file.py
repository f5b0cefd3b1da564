"""Description of a drive's HDF5 file, and its damages."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.inspect import drive_file
from tests.artefacts import write_graphs, write_labels

DRIVE = "2011_09_26_drive_0001"
FRAMES = np.array([2, 3, 4, 9, 10, 12])


@pytest.fixture
def graphs(tmp_path: Path) -> Path:
    path = tmp_path / f"graphs/semantic/{DRIVE}.h5"
    write_graphs(path, DRIVE, np.zeros(len(FRAMES)), FRAMES, 40, np.random.default_rng(0))
    return path


def test_frames_params_and_datasets(graphs: Path) -> None:
    content = drive_file.describe(graphs)
    assert (content["stage"], content["drive"], content["bytes"]) == ("graphs", DRIVE, graphs.stat().st_size)
    assert (content["frames"], content["first"], content["last"]) == (6, 2, 12)
    assert content["missing"] == "5-8, 11"
    assert content["duration_s"] == pytest.approx(1.0)
    assert content["params"] == {"graphs": {"k": 6, "keep_inter_class": 0.2}}
    rows = {row["dataset"]: row for row in content["datasets"]}
    with h5py.File(graphs) as file:
        assert set(rows) == set(file)
        for name, row in rows.items():
            assert (tuple(row["shape"]), row["dtype"]) == (file[name].shape, str(file[name].dtype))
            assert row["bytes"] == file[name].id.get_storage_size()
    assert rows["xyz"]["unit"] == "m"


def test_drive_without_frames(tmp_path: Path) -> None:
    write_labels(tmp_path / "labels/a.h5", DRIVE, np.zeros(0), np.zeros(0, int))
    content = drive_file.describe(tmp_path / "labels/a.h5")
    assert (content["frames"], content["first"], content["missing"]) == (0, None, "")


def change_schema(file: h5py.File) -> None:
    file.attrs["schema"] = 1


def remove_frames(file: h5py.File) -> None:
    del file["frame"]


def reverse_frames(file: h5py.File) -> None:
    file["frame"][:] = FRAMES[::-1]


def add_group(file: h5py.File) -> None:
    file.create_group("more")


def break_params(file: h5py.File) -> None:
    file.attrs["params"] = "{"


@pytest.mark.parametrize("damage", [change_schema, remove_frames, reverse_frames, add_group, break_params])
def test_damage_names_the_file(graphs: Path, damage: Callable[[h5py.File], None]) -> None:
    with h5py.File(graphs, "a") as file:
        damage(file)
    with pytest.raises(InputError, match=DRIVE):
        drive_file.describe(graphs)


@pytest.mark.parametrize("size", [0, 3000])
def test_cut_file_names_the_file(graphs: Path, size: int) -> None:
    graphs.write_bytes(graphs.read_bytes()[:size])
    with pytest.raises(InputError, match=DRIVE):
        drive_file.describe(graphs)
