from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from matplotlib.image import imread

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.graphs import cloud
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
    settings = yaml.safe_load(PARAMS.read_text(encoding="utf-8")) | {"pictures": {"frames": 3}}
    (folder / "params.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
    return folder


def draw(data: Path, out: Path, params: Path) -> dict[str, bytes]:
    assert pictures.main(data / "ingest", data / "perception", data / "clouds/pseudo", out, params, workers=1) == out
    return {path.name: path.read_bytes() for path in out.iterdir()}


def test_each_drive_with_images_has_a_picture(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drawn = draw(data, tmp_path / "a", data / "params.yaml")
    assert set(drawn) == {f"{LONG}.png", f"{SHORT}.png"}
    log = capsys.readouterr().out
    assert f"{LONG}: frames 1, 4, 7," in log
    assert f"{SHORT}: frames 0, 1," in log
    assert f"without images: {BLIND}" in log
    pixels = np.rint(255 * imread(tmp_path / f"a/{LONG}.png")[..., :3])
    shown = {number for number, colour in enumerate(classes.COLOURS) if (pixels == colour).all(axis=-1).sum() > 500}
    assert shown == {classes.ROAD, classes.BUILDING, classes.SKY}
    assert draw(data, tmp_path / "b", data / "params.yaml") == drawn


def test_clouds_of_other_frames_are_one_error(data: Path, tmp_path: Path) -> None:
    for stage in ("ingest", "perception"):
        (tmp_path / stage).symlink_to(data / stage)
    for name in (LONG, BLIND, SHORT):
        with store.DriveReader(data / f"clouds/pseudo/{name}.h5", stage="clouds") as old:
            ptr = old["ptr"]
            points = [tuple(old.rows(key, a, b) for key in ("xyz", "cls")) for a, b in pairwise(ptr)]
            path = tmp_path / f"clouds/pseudo/{name}.h5"
            with store.DriveWriter(path, stage="clouds", drive=name, params={}) as new:
                cloud.write(new, old.frame + 1000, old.time_s, points)
    store.write_index(tmp_path / "clouds/pseudo", SPLITS)
    with pytest.raises(InputError, match=r"clouds/pseudo/.*\.h5: no frame \d"):
        draw(tmp_path, tmp_path / "pictures", PARAMS)
