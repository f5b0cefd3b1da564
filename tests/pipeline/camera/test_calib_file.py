"""Calibration files: what is written is read again."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.calib_file import matrix, read_entries, write_entries


def test_there_and_back(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    P = np.random.default_rng(0).normal(0, 500, (3, 4))
    write_entries(path, {"calib_time": "01-Jan-2026 12:00:00", "P": P})
    assert path.read_text().startswith("calib_time: 01-Jan-2026 12:00:00\nP: ")
    entries = read_entries(path)
    np.testing.assert_allclose(matrix(entries, "P", (3, 4), path), P, rtol=1e-12)
    with pytest.raises(InputError, match=r"calib.txt: P is not 9 finite numbers"):
        matrix(entries, "P", (3, 3), path)
    with pytest.raises(InputError, match=r"calib.txt has no Q"):
        matrix(entries, "Q", (3,), path)
