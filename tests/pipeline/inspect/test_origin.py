"""The raw drive at the chain's end: where it lies, and whether its files are still those that were ingested."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from pipeline.inspect import origin, words
from pipeline.kitti.raw import RawDrive
from tests import kitti_drive
from tests.artefacts import write_labels

CHAIN = {"stages": [], "why": "said"}


@pytest.fixture
def data(tmp_path: Path) -> Path:
    folder = kitti_drive.write_drive(tmp_path / "raw")
    path = tmp_path / f"ingest/{kitti_drive.DRIVE}.h5"
    with store.DriveWriter(
        path, stage="ingest", drive=kitti_drive.DRIVE, params={"ingest": {"cameras": [2, 0]}}
    ) as file:
        file.attrs |= {"source": "kitti", "fingerprint": RawDrive(folder).fingerprint([2, 0])}
        file.put("frame", np.arange(4, dtype=np.int32))
        file.put("time_s", np.arange(4) * 0.1)
    store.write_index(path.parent, {kitti_drive.DRIVE: "train"})
    write_labels(tmp_path / "labels/a.h5", kitti_drive.DRIVE, np.zeros(4), np.arange(4))
    return tmp_path


def test_raw_files_are_the_same_changed_or_missing(data: Path) -> None:
    labels, folder = data / "labels/a.h5", data / f"raw/2011_09_26/{kitti_drive.DRIVE}_sync"
    (told,) = origin.of_drives(labels, [kitti_drive.DRIVE])
    assert (told["raw"], told["files"]) == (str(folder), "same")
    (folder / "oxts/data/0000000002.txt").write_text("1 2 3")
    (told,) = origin.of_drives(labels, [kitti_drive.DRIVE])
    assert told["files"] == "changed"
    folder.rename(data / "elsewhere")
    (told,) = origin.of_drives(labels, [kitti_drive.DRIVE])
    assert told["files"] == "missing"
    assert any("not here, fingerprint" in line for line in words.provenance(CHAIN, [told]))


def test_several_drives_are_named_and_one_that_is_not_ingested_is_said(data: Path) -> None:
    told = origin.of_drives(data / "labels", [kitti_drive.DRIVE, "2011_09_26_drive_0002"])
    assert "files" not in told[0]
    assert "is missing" in told[1]["error"]
    assert any("2 raw drives in" in line for line in words.provenance(CHAIN, told))
    assert origin.of_drives(data / "raw", [kitti_drive.DRIVE])[0]["files"] == "same"


def test_without_ingest_nothing_is_claimed(tmp_path: Path) -> None:
    assert origin.of_drives(tmp_path / "labels", ["a"]) == []
