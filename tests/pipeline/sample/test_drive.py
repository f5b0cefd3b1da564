"""A rendered drive: images, depths, scans and packets show the same scene."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.camera import classes, geometry
from pipeline.camera.images import read_pixels, to_metres
from pipeline.kitti.oxts import VF, WU, read_times
from pipeline.kitti.raw import KittiDrive, read_scan
from pipeline.sample import motion
from pipeline.sample.drive import render_drive
from pipeline.sample.motion import FRAMES_AFTER
from pipeline.sample.oxts import ALTITUDE_M
from pipeline.sample.rig import make_rig, rotation, write_calibration

NAME = "2026_01_01_drive_0001"
SIZE = (96, 320)
FRAMES = 8


def render(folder: Path, name: str = NAME, seed: int = 0, frames: int = 2) -> KittiDrive:
    path = folder / name[:10] / f"{name}_sync"
    render_drive(path, name, frames=frames, size=SIZE, scan_rays=(32, 200), seed=seed)
    write_calibration(make_rig(SIZE, name[:10]), path.parent)
    return KittiDrive(path)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> KittiDrive:
    return render(tmp_path_factory.mktemp("sample"), frames=FRAMES)


def test_oxts_continues_after_the_last_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The car drives on smoothly, and the frames with an image do not depend on those after them."""
    drive = render(tmp_path / "a", frames=4)
    rows, times = np.array([np.loadtxt(path) for path in drive.oxts.values()]), list(drive.oxts)
    speed_mps, yaw_rate_radps = rows[:, VF], rows[:, WU]
    time_s = read_times(drive.oxts_times, times)
    assert np.abs(np.diff(speed_mps) / np.diff(time_s)).max() < 2.5
    turned = np.cumsum(yaw_rate_radps[1:] * np.diff(time_s))
    np.testing.assert_allclose(np.unwrap(rows[1:, 5]) - rows[0, 5], turned, atol=0.03)
    monkeypatch.setattr(motion, "FRAMES_AFTER", 3)
    shorter = render(tmp_path / "b", frames=4)
    assert len(shorter.oxts) == 4 + 3
    for number in range(4):
        for files in (drive.oxts, drive.images(2), drive.scans):
            other = tmp_path / "b" / files[number].relative_to(tmp_path / "a")
            assert files[number].read_bytes() == other.read_bytes()


def test_scans_agree_with_dense_depth(drive: KittiDrive) -> None:
    camera = drive.camera(2)
    assert camera.T_cam_velo is not None
    errors = []
    for frame in (0, FRAMES - 1):
        depth = to_metres(read_pixels(drive.truth_depth[frame]))
        points = geometry.transform(camera.T_cam_velo, read_scan(drive.scans[frame])[:, :3].astype(np.float64))
        uv, z = geometry.project(points, camera.K)
        inside = (z > 0) & (uv > 0).all(axis=1) & (uv[:, 0] < SIZE[1] - 1) & (uv[:, 1] < SIZE[0] - 1)
        (u, v), z = np.floor(uv[inside]).astype(int).T, z[inside]
        corners = np.stack([depth[v, u], depth[v, u + 1], depth[v + 1, u], depth[v + 1, u + 1]])
        smooth = (corners.min(axis=0) > 0) & (corners.max(axis=0) < 1.15 * corners.min(axis=0))  # no silhouette
        # On a plane, inverse depth is linear in the pixel.
        du, dv = (uv[inside] - np.stack([u, v], axis=-1)).T
        weights = np.stack([(1 - du) * (1 - dv), du * (1 - dv), (1 - du) * dv, du * dv])
        interpolated = 1 / np.sum(weights / np.maximum(corners, 1e-3), axis=0)
        assert smooth.sum() > 300
        errors.append(np.abs(interpolated - z)[smooth])
    assert np.median(np.concatenate(errors)) < 0.05


@pytest.mark.parametrize("name", ["2026_01_04_drive_0003", "2026_01_05_drive_0003"])
def test_road_is_a_plane_below_the_camera(tmp_path: Path, name: str) -> None:
    """For two cameras and a narrow street; the images show the roll, pitch and heave of oxts."""
    drive = render(tmp_path, name)
    camera, rig = drive.camera(2), make_rig(SIZE, name[:10])
    np.testing.assert_allclose(camera.K, rig.camera.K, atol=1e-9)
    for frame in (0, 1):
        row = np.loadtxt(drive.oxts[frame])
        depth, cls = to_metres(read_pixels(drive.truth_depth[frame])), read_pixels(drive.truth_cls[frame])
        near_road = (cls == classes.ROAD) & (depth < 20)
        points = geometry.back_project(depth, camera.K)[near_road]
        up = geometry.transform(np.linalg.inv(rig.T_cam2_imu), points) @ rotation(*row[3:6]).T[:, 2]
        assert near_road.sum() > 1000
        assert np.abs(up + row[2] - ALTITUDE_M).max() < 0.02
        np.testing.assert_array_equal(depth[cls == classes.SKY], 0)


def test_static_world_moves_as_oxts_measures(drive: KittiDrive) -> None:
    """Points of the first frame, moved by the motion in oxts, land on the last frame's surfaces."""
    camera, rig = drive.camera(2), make_rig(SIZE, NAME[:10])
    rows = [np.loadtxt(drive.oxts[frame]) for frame in (0, FRAMES - 1)]
    poses = []
    for row in rows:
        east = np.deg2rad(row[1] - rows[0][1]) * 6378137 * np.cos(np.deg2rad(rows[0][0]))
        north = np.deg2rad(row[0] - rows[0][0]) * 6378137
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation(*row[3:6]), (east, north, row[2])
        poses.append(pose)
    T_last_first = rig.T_cam2_imu @ np.linalg.inv(poses[1]) @ poses[0] @ np.linalg.inv(rig.T_cam2_imu)
    depths = [to_metres(read_pixels(drive.truth_depth[frame])) for frame in (0, FRAMES - 1)]
    cls = read_pixels(drive.truth_cls[0])
    static = (depths[0] > 0) & (depths[0] < 40) & np.isin(cls, [classes.BUILDING, classes.ROAD, classes.SIDEWALK])
    points = geometry.transform(T_last_first, geometry.back_project(depths[0], camera.K)[static])
    uv, z = geometry.project(points, camera.K)
    inside = (z > 3) & (uv > 0.5).all(axis=1) & (uv[:, 0] < SIZE[1] - 1.5) & (uv[:, 1] < SIZE[0] - 1.5)
    u, v = np.rint(uv[inside]).astype(int).T
    assert inside.sum() > 2000
    assert np.median(np.abs(depths[1][v, u] - z[inside]) / z[inside]) < 0.02


def test_name_and_seed_determine_all_bytes(tmp_path: Path) -> None:
    first, again = render(tmp_path / "a"), render(tmp_path / "b")
    files = [path for path in first.folder.rglob("*") if path.is_file()]
    assert len(files) == 2 * 5 + FRAMES_AFTER + 3
    for path in files:
        assert path.read_bytes() == (again.folder / path.relative_to(first.folder)).read_bytes(), path
    for different in (render(tmp_path / "a", "2026_01_01_drive_0002"), render(tmp_path / "c", seed=1)):
        assert different.truth_depth[0].read_bytes() != first.truth_depth[0].read_bytes()
