"""What a drive's file holds is told rightly, and whatever is wrong with it in one line."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.base import store
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


def test_a_file_is_told_with_its_frames_settings_and_datasets(graphs: Path) -> None:
    told = drive_file.describe(graphs)
    assert (told["stage"], told["drive"], told["made_of"]) == ("graphs", DRIVE, [DRIVE])
    assert told["frames"] == {
        "count": 6, "gaps": [[5, 8], [11, 11]], "first": 2, "last": 12, "duration_s": pytest.approx(1.0),
    }  # fmt: skip
    assert told["settings"] == {"graphs": {"k": 6, "keep_inter_class": 0.2}}
    datasets = {one["name"]: one for one in told["datasets"]}
    with h5py.File(graphs) as file:
        assert set(datasets) == set(file)
        for name, one in datasets.items():
            assert (tuple(one["shape"]), one["dtype"]) == (file[name].shape, str(file[name].dtype))
            assert one["bytes"] == file[name].id.get_storage_size()
    assert datasets["xyz"]["unit"] == "m"
    assert 0 < sum(one["share"] for one in datasets.values()) < 1
    assert told["bytes"] == graphs.stat().st_size


def test_a_drive_without_frames_is_told(tmp_path: Path) -> None:
    write_labels(tmp_path / "labels/a.h5", DRIVE, np.zeros(0), np.zeros(0, int))
    assert drive_file.describe(tmp_path / "labels/a.h5")["frames"] == {"count": 0, "gaps": []}


def test_of_another_schema_is_said_by_the_stage_whose_folder_it_lies_in(graphs: Path) -> None:
    with h5py.File(graphs, "a") as file:
        file.attrs["schema"] = 1
    with pytest.raises(InputError, match=f"stage 'graphs', schema 1; this code reads stage 'graphs'.*{store.SCHEMA}"):
        drive_file.describe(graphs)


def empty(path: Path) -> None:
    path.write_bytes(b"")


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:3000])


def of_another_tool(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["data"] = np.zeros(3)


def without_frames(path: Path) -> None:
    with h5py.File(path, "a") as file:
        del file["frame"]


def frames_backwards(path: Path) -> None:
    with h5py.File(path, "a") as file:
        file["frame"][:] = FRAMES[::-1]


def times_not_finite(path: Path) -> None:
    with h5py.File(path, "a") as file:
        file["time_s"][2] = np.nan


def absurd_shape(path: Path) -> None:
    with h5py.File(path, "a") as file:
        del file["frame"]
        file.create_dataset("frame", shape=(10**12,), dtype=np.int32, chunks=(1024,))


def linked_elsewhere(path: Path) -> None:
    with h5py.File(path.with_name("other.h5"), "w") as other:
        other["xyz"] = np.zeros(3)
    with h5py.File(path, "a") as file:
        del file["xyz"]
        file["xyz"] = h5py.ExternalLink("other.h5", "xyz")


def frames_linked_elsewhere(path: Path) -> None:
    with h5py.File(path.with_name("other.h5"), "w") as other:
        other["frame"] = FRAMES
    with h5py.File(path, "a") as file:
        del file["frame"]
        file["frame"] = h5py.ExternalLink("other.h5", "frame")


def a_group(path: Path) -> None:
    with h5py.File(path, "a") as file:
        file.create_group("more")


def settings_no_json(path: Path) -> None:
    with h5py.File(path, "a") as file:
        file.attrs["params"] = "{"


@pytest.mark.parametrize(
    "damage",
    [
        empty, cut, of_another_tool, without_frames, frames_backwards, times_not_finite, absurd_shape, linked_elsewhere,
        frames_linked_elsewhere, a_group, settings_no_json,
    ],
)  # fmt: skip
def test_damage_is_one_line_that_names_the_file(graphs: Path, damage: object) -> None:
    assert callable(damage)
    damage(graphs)
    with pytest.raises(InputError) as error:
        drive_file.describe(graphs)
    assert str(graphs) in str(error.value)


def test_pointers_that_lead_elsewhere_are_refused(graphs: Path) -> None:
    with h5py.File(graphs, "a") as file:
        file["ptr"][1] = 10**9
    with drive_file.opened(graphs) as file, pytest.raises(InputError, match=r"ptr of row 0 goes from 0 to 1000000000"):
        drive_file.ragged(file, "xyz", "ptr", 0)
