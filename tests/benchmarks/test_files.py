"""The table of encodings: what is stored can be undone, and each filter has a row."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import files
from tests import artefacts


def test_what_is_stored_says_the_same_points_and_neighbours() -> None:
    rng = np.random.default_rng(0)
    xyz = (rng.integers(-80 * 1024, 80 * 1024, (50, 3)) / 1024).astype(np.float32)
    made = files.encodings(xyz)
    np.testing.assert_array_equal(made["int32 steps"] / 1024, xyz)
    np.testing.assert_array_equal(made["int32 differences"].cumsum(axis=0) / 1024, xyz)
    assert np.abs(made["int16 of 4 mm"] / 256 - xyz).max() <= 0.002
    degree = np.array([2, 1, 3], np.uint8)
    indices = np.array([5, 65_000, 0, 1, 2, 9], np.uint16)
    made = files.differences(indices, degree)
    np.testing.assert_array_equal(made["less the last"].cumsum(dtype=np.uint16), indices)
    np.testing.assert_array_equal(made["less the node"] + np.array([0, 0, 1, 2, 2, 2], np.uint16), indices)


def test_each_filter_has_a_row_of_bytes_and_times(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    artefacts.write_graphs(tmp_path / "a.h5", "a", np.zeros(3), np.arange(3), 40, np.random.default_rng(0))
    files.main(tmp_path / "a.h5", frames=2)
    head, _, *rows = capsys.readouterr().out.splitlines()
    assert [row.split(" | ")[0].removeprefix("| ") for row in rows] == list(files.FILTERS)
    assert all(row.count("|") == head.count("|") for row in rows)
