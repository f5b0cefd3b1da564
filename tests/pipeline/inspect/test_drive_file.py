"""Description of a drive's HDF5 file, and its damages."""

from pathlib import Path

import h5py
import numpy as np
import pytest

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
