from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from pipeline.base import store
from pipeline.camera import classes
from stages import clouds, pictures
from tests import street

PARAMS = Path(__file__).resolve().parents[2] / "params.yaml"
SPLITS = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train", "2026_01_03_drive_0001": "test"}
LONG, BLIND, SHORT = SPLITS


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ingest, perception and clouds of a drive, one without images, and one of two frames."""
    folder = tmp_path_factory.mktemp("data")
    for drive, frames in zip(SPLITS, (9, 3, 2), strict=True):
        street.write_drive(folder / "ingest", drive, frames, images=drive != BLIND)
        street.write_perception(folder / "perception", folder / "ingest", drive)
    for stage in ("ingest", "perception"):
        store.write_index(folder / stage, SPLITS)
    clouds.main(folder / "ingest", folder / "perception", folder / "clouds", PARAMS, workers=1)
    return folder


def draw(data: Path, out: Path) -> dict[str, bytes]:
    assert pictures.main(data / "ingest", data / "perception", data / "clouds/pseudo", out, PARAMS, workers=1) == out
    return {path.name: path.read_bytes() for path in out.iterdir()}


def test_each_drive_with_images_has_a_picture(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drawn = draw(data, tmp_path / "a")
    assert set(drawn) == {f"{LONG}.png", f"{SHORT}.png"}
    log = capsys.readouterr().out
    assert f"{LONG}: frames 1, 4, 7," in log
    assert f"{SHORT}: frames 0, 1," in log
    assert f"without images: {BLIND}" in log
    pixels = np.rint(255 * imread(tmp_path / f"a/{LONG}.png")[..., :3])
    shown = {number for number, colour in enumerate(classes.COLOURS) if (pixels == colour).all(axis=-1).sum() > 500}
    assert shown == {classes.ROAD, classes.BUILDING, classes.SKY}
    assert draw(data, tmp_path / "b") == drawn
