"""Pictures for people."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.camera import classes
from pipeline.camera.png import read_png
from pipeline.town import contact_sheet as figures


def test_depth_colours_run_from_red_to_blue_and_none_is_black() -> None:
    red, blue, none = figures.colourise_depth(np.array([[4.0, 80.0, 0.0]]))[0].astype(int)
    assert red[0] > red[2] + 50
    assert blue[2] > blue[0]
    assert none.tolist() == [0, 0, 0]


def test_a_sheet_has_a_row_per_view() -> None:
    rgb = np.full((10, 40, 3), 200, np.uint8)
    view = (rgb, np.full((10, 40), 5.0), np.full((10, 40), classes.CAR, np.uint8))
    sheet = figures.contact_sheet([view, view], width=80, gap=4)
    assert sheet.shape == (2 * 24 - 4, 3 * 84 - 4, 3)
    assert sheet[10, 40].tolist() == [200, 200, 200]
    assert sheet[10, 2 * 84 + 40].tolist() == classes.COLOURS[classes.CAR].tolist()
    with pytest.raises(ValueError, match="at least one view"):
        figures.contact_sheet([])


def test_a_written_picture_reads_back(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 255, (5, 6, 3), np.uint8)
    figures.write_rgb(tmp_path / "a.png", picture)
    np.testing.assert_array_equal(read_png(tmp_path / "a.png"), picture)
