"""Stage clouds, on drives with LiDAR, images, or both; and motion of drives that do not move or have no images."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from pipeline.base import store
from pipeline.base.resume import ROOT
from pipeline.camera import classes
from pipeline.motion.drive import measure_drive
from stages import clouds
from tests import street

SPLITS = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train", "2026_01_03_drive_0001": "test"}
FULL, BLIND, CAMERA = SPLITS


def read(folder: Path, drive: str) -> dict[str, np.ndarray]:
    with store.DriveReader(folder / f"{drive}.h5", stage="clouds") as file:
        return {name: file[name] for name in file.names}


@pytest.mark.parametrize("lidar", [True, False])
def test_drives_without_images_or_lidar_have_clouds_of_what_they_have(tmp_path, lidar):
    """Of a drive with everything; one without images has no classes, one without LiDAR has no frames."""
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    params["ingest"]["lidar"] = lidar
    (tmp_path / "params.yaml").write_text(yaml.safe_dump(params))
    street.write_drive(tmp_path / "ingest", FULL, 4, lidar=True)
    street.write_drive(tmp_path / "ingest", BLIND, 3, lidar=True, images=False, dense=False)
    street.write_drive(tmp_path / "ingest", CAMERA, 3)
    for drive in SPLITS:
        street.write_perception(tmp_path / "perception", tmp_path / "ingest", drive)
    for drive in (BLIND, CAMERA):
        files = [tmp_path / f"{stage}/{drive}.h5" for stage in ("motion", "ingest", "perception")]
        assert measure_drive(*files)["valid"] == 0
    store.write_index(tmp_path / "ingest", SPLITS)
    clouds.main(tmp_path / "ingest", tmp_path / "perception", tmp_path / "clouds", tmp_path / "params.yaml", workers=1)
    assert bool(store.read_index(tmp_path / "clouds/lidar", stage="clouds")) == lidar
    if not lidar:
        return
    assert {classes.ROAD, classes.BUILDING} <= set(read(tmp_path / "clouds/lidar", FULL)["cls"].tolist())
    blind = read(tmp_path / "clouds/lidar", BLIND)
    assert len(blind["xyz"]) > 0
    assert (blind["cls"] == classes.VOID).all()
    assert len(read(tmp_path / "clouds/lidar", CAMERA)["frame"]) == 0
