"""The contact sheet: pictures for people."""

from pathlib import Path

import numpy as np
import pytest
from pipeline.camera.png import read_png

from pipeline.camera import classes
from pipeline.town.contact_sheet import contact_sheet, write_rgb


def test_a_sheet_has_a_row_per_view() -> None:
    rgb = np.full((10, 40, 3), 200, np.uint8)
    depth_m = np.full((10, 40), 8.0)
    depth_m[:5] = 0
    view = (rgb, depth_m, np.full((10, 40), classes.CAR, np.uint8))
    sheet = contact_sheet([view, view], width=80, gap=4)
    assert sheet.shape == (2 * 24 - 4, 3 * 84 - 4, 3)
    assert sheet[5, 84 + 40].tolist() == [0, 0, 0]
    assert sheet[15, 84 + 40].tolist() == [127, 127, 127]  # half as near as white
    assert sheet[10, 40].tolist() == [200, 200, 200]
    assert sheet[10, 2 * 84 + 40].tolist() == classes.COLOURS[classes.CAR].tolist()
    with pytest.raises(ValueError, match="at least one view"):
        contact_sheet([])


def test_a_written_picture_reads_back(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 255, (5, 6, 3), np.uint8)
    write_rgb(tmp_path / "a.png", picture)
    np.testing.assert_array_equal(read_png(tmp_path / "a.png"), picture)
