"""A drive's file says what no stage can have written: it is refused by a line with file and dataset."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError

DRIVE = "2011_09_26_drive_0001"


def write(folder: Path) -> Path:
    path = folder / f"{DRIVE}.h5"
    with store.DriveWriter(path, stage="clouds", drive=DRIVE, params={}) as file:
        file.put("frame", np.arange(4, dtype=np.int32))
        file.put("time_s", np.arange(4) / 10, "s")
        file.append("xyz", np.ones((9, 3), np.float32), "m")
        file.append("cls", np.ones(9, np.uint8))
        file.put_pointers("ptr", [2, 0, 3, 4])
    return path


def read(path: Path) -> dict[str, np.ndarray]:
    with store.DriveReader(path, stage="clouds") as file:
        return {name: file[name] for name in file.names}


def replaced(name: str, array: np.ndarray) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = array

    return change


def link(file: h5py.File) -> None:
    del file["cls"]
    file["cls"] = h5py.ExternalLink("/dev/zero", "/cls")


def absurd(file: h5py.File) -> None:
    del file["xyz"]
    file.create_dataset("xyz", shape=(9, 1 << 28), chunks=(1, 1 << 28), dtype=np.float32)


CHANGES: dict[str, tuple[Callable[[h5py.File], object], str]] = {
    "drive": (lambda file: file.attrs.update(drive="2011_09_26_drive_0002"), "of drive 2011_09_26_drive_0002, under"),
    "link": (link, "'cls' is a link to elsewhere"),
    "absurd": (absurd, r"in dataset 'ptr' .*a frame of 4 rows of xyz is too large"),
    "text": (replaced("cls", np.array(["x"] * 9, "S1")), r"in dataset 'cls' .*not rows of numbers"),
    "frames twice": (replaced("frame", np.int32([0, 1, 1, 2])), r"in dataset 'frame' .*does not rise"),
    "frames below 0": (replaced("frame", np.int32([-1, 0, 1, 2])), r"in dataset 'frame' .*below 0"),
    "times": (replaced("time_s", np.array([0, np.nan, 1, 2])), r"in dataset 'time_s' .*not finite"),
    "rows": (replaced("time_s", np.arange(5.0)), r"in dataset 'time_s' .*5 rows for 4 frames"),
    "back": (replaced("ptr", np.array([0, 4, 2, 5, 9])), r"in dataset 'ptr' .*does not count up"),
    "beyond": (replaced("ptr", np.array([0, 2, 2, 5, 10])), r"in dataset 'ptr' .*ends at 10.*9 rows of cls"),
    "pointers": (replaced("ptr", np.array([0, 9])), r"in dataset 'ptr' .*for 4 frames"),
}  # fmt: skip


@pytest.mark.parametrize("what", CHANGES)
def test_what_no_stage_writes_is_refused(tmp_path: Path, what: str) -> None:
    path = write(tmp_path)
    change, message = CHANGES[what]
    with h5py.File(path, "r+") as file:
        change(file)
    hint = "Delete it and fetch it: dvc pull .*make it again: dvc repro --force --single-item clouds"
    with pytest.raises(InputError, match=f"^{path} is damaged.*{message}.*{hint}$"):
        read(path)


def test_a_sound_file_is_read_under_any_name_but_another_drives(tmp_path: Path) -> None:
    path = write(tmp_path)
    expected = read(path)
    for name in ("copy.h5", f"{DRIVE}.part.h5"):
        for key, array in read(path.rename(tmp_path / name)).items():
            np.testing.assert_array_equal(array, expected[key])
        path = tmp_path / name
    with pytest.raises(InputError, match="under the name of another"):
        read(path.rename(tmp_path / "2011_09_26_drive_0009.h5"))


def test_every_flipped_bit_of_a_small_column_is_noticed(tmp_path: Path) -> None:
    path = write(tmp_path)
    with h5py.File(path) as file:
        place = file["time_s"].id.get_chunk_info(0)
    content = path.read_bytes()
    for at in range(place.byte_offset, place.byte_offset + place.size):
        path.write_bytes(content[:at] + bytes([content[at] ^ 4]) + content[at + 1 :])
        with pytest.raises(InputError, match="in dataset 'time_s'"):
            read(path)
