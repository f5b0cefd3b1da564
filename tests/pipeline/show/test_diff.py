"""Differences of drives' files, JSON and other files."""

import os
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

from pipeline.base.errors import InputError
from pipeline.show import diff
from pipeline.show.diff import Difference
from tests.artefacts import write_dataset

DRIVE = "2026_01_01_drive_0001"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two folders, a and b, with the same labels and graphs of one drive."""
    for name in "ab":
        write_dataset(tmp_path / name, {DRIVE: "train"}, frames=12, points=30)
    return tmp_path


def compare_drives(folder: Path, stage: str, tolerance: float = 0.0) -> list[Difference]:
    pair = (folder / name / stage / f"{DRIVE}.h5" for name in "ab")
    return list(diff.compare(stage, *pair, tolerance))


def change(folder: Path, stage: str, edit: Callable[[h5py.File], None]) -> None:
    with h5py.File(folder / "b" / stage / f"{DRIVE}.h5", "r+") as file:
        edit(file)


def compare_texts(folder: Path, name: str, a: str, b: str, tolerance: float = 0.0) -> dict[str, Difference]:
    for which, content in (("a", a), ("b", b)):
        (folder / which).mkdir(exist_ok=True)
        (folder / which / name).write_text(content)
    differences = diff.compare(name, folder / "a" / name, folder / "b" / name, tolerance)
    return {difference.key: difference for difference in differences}


def test_values_of_frames(folder: Path) -> None:
    def edit(file: h5py.File) -> None:
        file["steering_rad"][3] += 0.25
        file["steering_rad"][7] -= 0.5
        file["speed_mps"][2] += 9.0

    change(folder, "labels", edit)
    speed, steering = compare_drives(folder, "labels")
    assert (speed.key, speed.problem, speed.frames, speed.first_frame) == ("speed_mps", "8.0 and 17.0", 1, 2)
    assert (steering.key, steering.frames, steering.first_frame) == ("steering_rad", 2, 3)
    assert steering.largest == pytest.approx(0.5)
    assert compare_drives(folder, "labels", tolerance=0.5) == [speed]


def test_json_by_key(tmp_path: Path) -> None:
    a = '{"test": {"nmse": 0.25, "frames": 9, "x": null}, "seeds": [0, 1], "on": true, "old": 1}'
    b = '{"test": {"nmse": 0.5, "frames": 9.0, "x": 3}, "seeds": [0, 1, 2], "on": 1, "new": 1}'
    differences = compare_texts(tmp_path, "metrics.json", a, b)
    assert {key: difference.problem for key, difference in differences.items()} == {
        "test.nmse": "0.25 and 0.5", "test.x": "None and 3", "seeds[2]": "only in B", "on": "True and 1",
        "old": "only in A", "new": "only in B",
    }  # fmt: skip
    assert differences["test.nmse"].largest == 0.25
    assert "test.nmse" not in compare_texts(tmp_path, "metrics.json", a, b, tolerance=0.3)
    assert compare_texts(tmp_path, "metrics.json", '{"a": [1, 2]}', '{"a":[1.0,2]}') == {}


def test_folders_are_compared_file_by_file(tmp_path: Path) -> None:
    for name in ("a/x/one.json", "a/table.md", "b/table.md", "b/x/two.json", "a/.resume/block.h5"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    differences = [
        difference for pair in diff.pairs(tmp_path / "a", tmp_path / "b") for difference in diff.compare(*pair, 0.0)
    ]
    assert [str(difference) for difference in differences] == [
        "table.md: 10 and 10 bytes, not the same", "x/one.json: only in A", "x/two.json: only in B",
    ]  # fmt: skip


def test_pipes_are_not_compared(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="no such file"):
        diff.pairs(tmp_path / "pipe", tmp_path / "pipe")
