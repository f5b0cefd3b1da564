"""Two files of a drive, compared by frame number and dataset."""

import json
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.store import DriveWriter
from pipeline.inspect.compare import artefacts, drives
from pipeline.inspect.compare.difference import Difference
from tests.artefacts import WHEELBASE_M, write_dataset, write_labels, write_sets

DRIVE = "2026_01_01_drive_0001"
FRAMES = np.arange(10, 22)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two folders, a and b, of one drive's labels and graphs, the same in both."""
    for name in "ab":
        write_dataset(tmp_path / name, {DRIVE: "train"}, frames=12, points=30)
    return tmp_path


def differences(folder: Path, what: str, tolerance: float = 0.0) -> list[Difference]:
    pair = (folder / name / what / f"{DRIVE}.h5" for name in "ab")
    return list(artefacts.compare(what, *pair, tolerance))


def change(folder: Path, what: str, how: Callable[[h5py.File], None]) -> None:
    with h5py.File(folder / "b" / what / f"{DRIVE}.h5", "r+") as file:
        how(file)


def test_what_is_the_same_has_no_difference_whatever_its_bytes(folder: Path) -> None:
    assert differences(folder, "labels") == differences(folder, "graphs/semantic") == []

    def note(file: h5py.File) -> None:
        file["noted"] = 1
        del file["noted"]

    change(folder, "graphs/semantic", note)
    pair = [folder / name / f"graphs/semantic/{DRIVE}.h5" for name in "ab"]
    assert pair[0].read_bytes() != pair[1].read_bytes()
    assert differences(folder, "graphs/semantic") == []


def test_a_value_per_frame_is_named_by_frame_and_size(folder: Path) -> None:
    def bend(file: h5py.File) -> None:
        file["steering_rad"][3] += 0.25
        file["steering_rad"][7] -= 0.5
        file["speed_mps"][2] += 9.0

    change(folder, "labels", bend)
    speed, steering = differences(folder, "labels")
    assert (steering.where, steering.drive, steering.count, steering.total) == ("steering_rad", DRIVE, 2, 12)
    assert (steering.frames, steering.first_frame, steering.largest_frame) == (2, 3, 7)
    assert steering.largest == pytest.approx(0.5)
    assert str(steering) == (
        f"labels: {DRIVE}: steering_rad: 2 of 12 values, in 2 frames, first 3, largest difference 0.5 rad in frame 7"
    )
    assert (speed.where, speed.count, speed.largest, speed.first_frame) == ("speed_mps", 1, pytest.approx(9.0), 2)
    (only_speed,) = differences(folder, "labels", tolerance=0.5)
    assert only_speed == speed


@pytest.mark.parametrize("whole_bytes", [1 << 24, 64])
def test_ragged_data_belongs_to_frames(folder: Path, monkeypatch: pytest.MonkeyPatch, whole_bytes: int) -> None:
    monkeypatch.setattr(drives, "_WHOLE_BYTES", whole_bytes)

    def move(file: h5py.File) -> None:
        file["xyz"][30 * 4 + 2, 1] += 2.0
        file["degree"][30 * 11] += 1
        pointer = file["indices_ptr"][:]
        pointer[6] -= 1  # an edge of frame 5 becomes one of frame 6
        file["indices_ptr"][:] = pointer

    change(folder, "graphs/semantic", move)
    degree, indices, pointer, xyz = differences(folder, "graphs/semantic")
    assert (degree.where, degree.first_frame, degree.largest, degree.total) == ("degree", 11, 1, 12 * 30)
    assert (indices.where, indices.frames, indices.resized, indices.first_frame) == ("indices", 2, 2, 5)
    assert (pointer.where, pointer.count, pointer.largest, pointer.first_frame) == ("indices_ptr", 2, 1, 5)
    assert (xyz.where, xyz.frames, xyz.first_frame, xyz.count, xyz.total) == ("xyz", 1, 4, 1, 3 * 12 * 30)
    assert xyz.largest == pytest.approx(2.0, rel=1e-5)
    assert "in 2 frames, first 5, another number of rows in 2 of them" in str(indices)


def test_frames_are_matched_by_number(tmp_path: Path) -> None:
    steering = 0.1 * np.sin(FRAMES)
    for name, rows in (("a", slice(0, 9)), ("b", slice(2, 12))):
        write_labels(tmp_path / name / f"labels/{DRIVE}.h5", DRIVE, steering[rows], FRAMES[rows])
    found = differences(tmp_path, "labels")
    assert [(each.where, each.how) for each in found] == [
        ("frame", "2 only in A, first 10"),
        ("frame", "3 only in B, first 19"),
    ]


def test_settings_datasets_types_and_shapes_count(folder: Path) -> None:
    def change_form(file: h5py.File) -> None:
        params = json.loads(file.attrs["params"])
        params["labels"]["wheelbase_m"] = 2.5
        file.attrs["params"] = json.dumps(params)
        del file["valid"]
        file["more"] = np.arange(12)
        speed = file["speed_mps"][:]
        del file["speed_mps"]
        file["speed_mps"] = speed.astype(np.float32)
        file["speed_mps"].attrs["unit"] = "km/h"
        del file["yaw_rate_radps"]
        file["yaw_rate_radps"] = np.zeros((12, 2))

    change(folder, "labels", change_form)
    assert WHEELBASE_M == 2.7
    said = {each.where: each.how for each in differences(folder, "labels")}
    assert said == {
        "params.labels.wheelbase_m": "2.7 and 2.5",
        "more": "only in B",
        "valid": "only in A",
        "speed_mps": "dtype float64 and float32, unit m/s and km/h",
        "yaw_rate_radps": "unit rad/s, left positive and none, shape (12,) and (12, 2)",
    }


def test_what_is_of_the_drive_is_compared_as_a_whole(tmp_path: Path) -> None:
    for name, focal in (("a", 1.0), ("b", 1.5)):
        path = tmp_path / name / f"ingest/{DRIVE}.h5"
        with DriveWriter(path, stage="ingest", drive=DRIVE, params={}) as file:
            file.put("frame", FRAMES.astype(np.int32))
            file.put("K", np.diag([focal, 1, 1]))
            file.put("image", np.zeros((12, 4, 5, 3), np.uint8))
    (found,) = differences(tmp_path, "ingest")
    assert (found.where, found.count, found.total, found.largest, found.frames) == ("K", 1, 9, 0.5, 0)


def test_levels_of_samplings_share_a_pointer(tmp_path: Path) -> None:
    for name in "ab":
        write_dataset(tmp_path / name, {DRIVE: "train"}, frames=5, points=40, write=write_sets)
    change(tmp_path, "graphs/semantic", lambda file: file["neighbours_1"].write_direct(1 + file["neighbours_1"][:]))
    (found,) = differences(tmp_path, "graphs/semantic")
    assert (found.where, found.frames, found.largest) == ("neighbours_1", 5, 1)


@pytest.mark.parametrize("damage", ["cut", "pointer", "stage"])
def test_a_damaged_file_is_one_line(folder: Path, damage: str) -> None:
    path = folder / f"b/graphs/semantic/{DRIVE}.h5"
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:-1000])
    elif damage == "pointer":
        change(folder, "graphs/semantic", lambda file: file["ptr"].write_direct(np.full(13, -5)))
    else:
        change(folder, "graphs/semantic", lambda file: file.attrs.__setitem__("stage", "nothing"))
    with pytest.raises(InputError, match=r"damaged|has stage 'nothing'"):
        differences(folder, "graphs/semantic")
