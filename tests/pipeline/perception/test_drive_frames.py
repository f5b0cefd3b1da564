"""Forged files of stages ingest and perception are refused with one line."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.perception.drive_frames import open_frames
from tests import street

DRIVE = "2026_01_01_drive_0001"


@pytest.mark.parametrize(
    ("stage", "name", "value", "problem"),
    [
        ("perception", "frame", [0, 9], "has frame 9, which the drive lacks"),
        ("perception", "depth_m", np.ones((2, 3, 4), np.uint16), "depth_m is not uint16"),
        ("perception", "depth_m", np.ones((2, *street.SIZE)), "depth_m is not uint16"),
        ("perception", "cls", np.ones((2, *street.SIZE), np.int64), "cls is not uint8"),
        ("perception", "camera_height_m", np.nan, "camera_height_m"),
        ("perception", "camera_height_m", None, "camera_height_m"),
        ("perception", "params", np.bytes_(b"{}"), "params"),
        ("ingest", "K", np.zeros((3, 3)), "image or K is damaged"),
        ("ingest", "image", np.ones((2, *street.SIZE), np.uint8), "image or K is damaged"),
    ],
)
def test_a_forged_file_is_refused(tmp_path: Path, stage: str, name: str, value: Any, problem: str) -> None:
    street.write_drive(tmp_path / "ingest", DRIVE, 2)
    street.write_perception(tmp_path / "perception", tmp_path / "ingest", DRIVE)
    with h5py.File(tmp_path / stage / f"{DRIVE}.h5", "r+") as file:
        holder = file.attrs if name in file.attrs else file
        del holder[name]
        if value is not None:
            holder[name] = value
    with (
        pytest.raises(InputError, match=problem),
        open_frames(tmp_path / "ingest", tmp_path / "perception", DRIVE, "visual"),
    ):
        pass
