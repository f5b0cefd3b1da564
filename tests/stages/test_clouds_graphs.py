"""Stages clouds and graphs, one after the other."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from pipeline.base import store
from pipeline.base.resume import ROOT
from pipeline.camera import classes, geometry
from pipeline.motion.drive import measure_drive
from stages import clouds, graphs
from tests import street
from tests.artefacts import write_motion

SPLITS = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train", "2026_01_03_drive_0001": "test"}
FULL, BLIND, CAMERA = SPLITS
FRAMES = 4
PSEUDO: dict[str, object] = {"source": "clouds/pseudo", "points": 300, "k": 4}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Clouds of a drive with everything, one without images, one without LiDAR; the first moves one metre per frame."""
    folder = tmp_path_factory.mktemp("data")
    street.write_drive(folder / "ingest", FULL, FRAMES, lidar=True)
    street.write_drive(folder / "ingest", BLIND, 3, lidar=True, images=False, dense=False)
    street.write_drive(folder / "ingest", CAMERA, 3)
    for drive in SPLITS:
        street.write_perception(folder / "perception", folder / "ingest", drive)
    write_motion(folder / "motion", FULL, {0: (0, 0), 1: (10, 0), 2: (10, 0), 3: (0, 0)})
    for drive in (BLIND, CAMERA):
        files = [folder / f"{stage}/{drive}.h5" for stage in ("motion", "ingest", "perception")]
        assert measure_drive(*files)["valid"] == 0
    store.write_index(folder / "ingest", SPLITS)
    clouds.main(folder / "ingest", folder / "perception", folder / "clouds", ROOT / "params.yaml", workers=1)
    return folder


def run_graphs(data: Path, out: Path, **variant: object) -> dict[str, np.ndarray]:
    out.mkdir(exist_ok=True)
    (out / "params.yaml").write_text(yaml.safe_dump({"graphs": {"v": PSEUDO | variant}}))
    return read(graphs.main("v", data, out, out / "params.yaml", workers=1), "graphs")


def read(folder: Path, stage: str, drive: str = FULL) -> dict[str, np.ndarray]:
    with store.DriveReader(folder / f"{drive}.h5", stage=stage) as file:
        return {name: file[name] for name in file.names}


def test_lidar_clouds_are_in_the_camera_frame(data: Path) -> None:
    raw, content = read(data / "ingest", "ingest"), read(data / "clouds/lidar", "clouds")
    (a, b), (c, d) = raw["lidar_ptr"][1:3], content["ptr"][1:3]
    points = geometry.transform(raw["T_cam_velo"], raw["lidar"][a:b, :3].astype(np.float64))
    assert np.abs(np.sort(content["xyz"][c:d], axis=0) - np.sort(points, axis=0)).max() < 0.001
    assert {classes.ROAD, classes.BUILDING} <= set(content["cls"][c:d].tolist())
    blind = read(data / "clouds/lidar", "clouds", BLIND)
    assert len(blind["xyz"]) > 0
    assert (blind["cls"] == classes.VOID).all()
    assert len(read(data / "clouds/lidar", "clouds", CAMERA)["frame"]) == 0


def test_an_accumulated_cloud_combines_frames(data: Path, tmp_path: Path) -> None:
    variant = {"crop_m": [-20, -3, 20, 30], "sampling": "range", "k": 0}
    single = run_graphs(data, tmp_path / "graphs", **variant)
    content = run_graphs(data, tmp_path / "graphs", **variant, accumulate={"frames": 3})
    assert (np.diff(content["ptr"]) == 300).all()
    assert not content["degree"].any()
    clouds = np.split(content["xyz"], content["ptr"][1:-1])
    assert all(((points[:, 2] >= -3) & (points[:, 2] <= 30)).all() for points in clouds)
    assert (clouds[0] == single["xyz"][: single["ptr"][1]]).all()
    nearest = [points[:, 2].min() for points in clouds]
    assert nearest[2] < nearest[0] - 1.5  # two metres since the first frame
    assert nearest[3] > nearest[2] + 1  # motion is not valid
