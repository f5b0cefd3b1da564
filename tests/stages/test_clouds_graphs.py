"""Stages clouds and graphs, one after the other."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from pipeline.base import store
from pipeline.camera import classes, geometry
from pipeline.camera.images import DEPTH_UNITS_PER_M
from pipeline.graphs import cloud
from stages import clouds, graphs
from tests import street
from tests.motion_files import write_motion

PARAMS = Path(__file__).resolve().parents[2] / "params.yaml"
SPLITS = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train", "2026_01_03_drive_0001": "test"}
FULL, BLIND, CAMERA = SPLITS
FRAMES = 4
PSEUDO: dict[str, object] = {"source": "clouds/pseudo", "points": 300, "k": 4}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ingest, perception and clouds of a drive with everything, one without images, one without LiDAR; no motion."""
    folder = tmp_path_factory.mktemp("data")
    street.write_drive(folder / "ingest", FULL, FRAMES, lidar=True)
    street.write_drive(folder / "ingest", BLIND, 3, lidar=True, images=False, dense=False)
    street.write_drive(folder / "ingest", CAMERA, 3)
    for drive in SPLITS:
        street.write_perception(folder / "perception", folder / "ingest", drive)
    store.write_index(folder / "ingest", SPLITS)
    store.write_index(folder / "perception", SPLITS)
    run_clouds(folder, folder / "clouds")
    for drive in SPLITS:
        write_motion(folder / "motion", drive, {})
    return folder


def run_clouds(data: Path, out: Path, **settings: object) -> None:
    params = yaml.safe_load(PARAMS.read_text())
    params["clouds"] |= settings
    (data / "params.yaml").write_text(yaml.safe_dump(params))
    assert clouds.main(data / "ingest", data / "perception", out, data / "params.yaml", workers=1) == out


def run_graphs(data: Path, out: Path, **variant: object) -> Path:
    out.mkdir(exist_ok=True)
    (out / "params.yaml").write_text(yaml.safe_dump({"graphs": {"v": variant}}))
    folder = graphs.main("v", data, out, out / "params.yaml", workers=1)
    assert folder == out / "v"
    return folder


def read(folder: Path, drive: str = FULL, stage: str = "graphs") -> dict[str, np.ndarray]:
    with store.DriveReader(folder / f"{drive}.h5", stage=stage) as file:
        return {name: file[name] for name in file.names}


def test_pseudo_clouds_are_back_projected_pixels(data: Path) -> None:
    content = read(data / "clouds/pseudo", stage="clouds")
    ptr = content["ptr"]
    for frame in range(FRAMES):
        _, depth, truth = street.scene(frame)
        points, labels = (content[name][ptr[frame] : ptr[frame + 1]] for name in ("xyz", "cls"))
        assert len(points) == (depth > 0).sum()
        uv, z = geometry.project(points.astype(np.float64), street.K)
        u, v = np.rint(uv).astype(int).T
        assert z == pytest.approx(depth[v, u], abs=0.5 / DEPTH_UNITS_PER_M + 0.001)
        assert (labels == truth[v, u]).all()
        assert (cloud.morton_order(points) == np.arange(len(points))).all()


def test_lidar_clouds_are_in_the_camera_frame(data: Path) -> None:
    raw, content = read(data / "ingest", stage="ingest"), read(data / "clouds/lidar", stage="clouds")
    (a, b), (c, d) = raw["lidar_ptr"][1:3], content["ptr"][1:3]
    points = geometry.transform(raw["T_cam_velo"], raw["lidar"][a:b, :3].astype(np.float64))
    assert np.abs(np.sort(content["xyz"][c:d], axis=0) - np.sort(points, axis=0)).max() < 0.001
    assert {classes.ROAD, classes.BUILDING} <= set(content["cls"][c:d].tolist())
    blind = read(data / "clouds/lidar", BLIND, "clouds")
    assert len(blind["xyz"]) > 0
    assert (blind["cls"] == classes.VOID).all()


def test_pruning_removes_only_edges_between_classes(data: Path, tmp_path: Path) -> None:
    full, pruned = (read(run_graphs(data, tmp_path, **PSEUDO, keep_inter_class=keep)) for keep in (1.0, 0.2))
    for content in (full, pruned):
        assert np.diff(content["ptr"]).tolist() == [300] * FRAMES
        assert (content["edges_knn"] == 300 * 4).all()
        assert content["indices_ptr"][-1] == len(content["indices"]) == content["degree"].sum(dtype=np.int64)
        assert content["indices"].dtype == np.uint16
    assert (full["xyz"] == pruned["xyz"]).all()
    assert (full["edges_kept"] == full["edges_knn"]).all()
    assert (pruned["edges_kept"] < full["edges_kept"]).all()


def test_points_without_edges_sampled_by_range(data: Path, tmp_path: Path) -> None:
    content = read(run_graphs(data, tmp_path, **{**PSEUDO, "k": 0, "sampling": "range"}))
    uniform = read(run_graphs(data, tmp_path, **PSEUDO))
    assert np.diff(content["ptr"]).tolist() == [300] * FRAMES
    assert not content["degree"].any()
    assert len(content["indices"]) == content["edges_knn"].sum() == 0
    far = [np.hypot(points[:, 0], points[:, 2]) > 20 for points in (content["xyz"], uniform["xyz"])]
    assert far[0].mean() > 1.5 * far[1].mean()


def test_an_accumulated_cloud_combines_frames(data: Path, tmp_path: Path) -> None:
    (tmp_path / "clouds").symlink_to(data / "clouds")
    for drive in SPLITS:  # straight on, one metre per frame
        write_motion(tmp_path / "motion", drive, {0: (0, 0), 1: (10, 0), 2: (10, 0), 3: (0, 0)})
    variant = {**PSEUDO, "crop_m": [-20, -3, 20, 30]}
    single = read(run_graphs(tmp_path, tmp_path / "graphs", **variant))
    content = read(run_graphs(tmp_path, tmp_path / "graphs", **variant, accumulate={"frames": 3}))
    assert (np.diff(content["ptr"]) == 300).all()
    clouds = np.split(content["xyz"], content["ptr"][1:-1])
    for points in clouds:
        assert (cloud.morton_order(points) == np.arange(300)).all()
        assert ((points[:, 2] >= -3) & (points[:, 2] <= 30)).all()
    assert (clouds[0] == single["xyz"][: single["ptr"][1]]).all()
    nearest = [points[:, 2].min() for points in clouds]
    assert nearest[2] < nearest[0] - 1.5  # two metres since the first frame
    assert nearest[3] > nearest[2] + 1  # motion is not valid
