"""The experiment at a small part of its size, on noise in KITTI's layouts."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from benchmarks import real_depth
from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base.errors import InputError
from pipeline.camera.geometry import project, transform
from pipeline.encoder.perceive import save
from pipeline.kitti.calibration import read_camera
from pipeline.kitti.raw import find_drives
from pipeline.sections.preset import find
from tests.kitti_drive import SIZE, scan, write, write_drive, write_png

RNG = np.random.default_rng(0)
MATRICES = {
    "P2": np.hstack([[[50, 0, 31], [0, 50, 22], [0, 0, 1]], RNG.normal(0, 0.1, (3, 1))]),
    "R0_rect": Rotation.from_rotvec([0.01, -0.02, 0.03]).as_matrix(),
    "Tr_velo_to_cam": np.hstack([[[0, -1, 0], [0, 0, -1], [1, 0, 0]], RNG.normal(0, 0.1, (3, 1))]),
}


@pytest.fixture
def kitti(tmp_path: Path) -> Path:
    root = tmp_path / "kitti"
    drive = write_drive(root, real_depth.FITTED, range(48))
    write(drive / "oxts/timestamps.txt", "".join(f"2011-09-26 13:02:{25 + i / 10:012.9f}\n" for i in range(48)))
    write_drive(root, real_depth.ELSEWHERE, [5])
    for number in real_depth.OBJECTS.values():
        write_png(root / f"object/image_2/{number}.png", RNG.integers(0, 256, (*SIZE, 3), np.uint8))
        write(root / f"object/velodyne/{number}.bin", scan(RNG).tobytes())
        text = "\n".join(f"{name}: {' '.join(map(str, matrix.ravel()))}" for name, matrix in MATRICES.items())
        write(root / f"object/calib/{number}.txt", f"{text}\n\n")  # KITTI's end so
    return root


def test_frames_that_are_scored_were_not_fitted(kitti: Path, tmp_path: Path) -> None:
    real_depth.lay_out(kitti, tmp_path)
    drives = find_drives(tmp_path, list(real_depth.PLACES))
    expected = [list(range(40)), list(range(40, 48)), [0], [0], [0], [5]]
    for frames in ([list(drive.images(2)), list(drive.scans), list(drive.oxts)] for drive in drives.values()):
        assert frames == [expected.pop(0)] * 3


@pytest.mark.slow
def test_each_place_has_its_line(
    kitti: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEER_WORKERS", "1")
    changes = yaml.safe_load(find("real").read_text())
    save(tmp_path, "small", UnifiedEncoder("small").state_dict())
    changes["encoder"] |= {"backbone": "small", "weights": str(tmp_path / "encoder.pt"), "frames": 4}
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(changes))
    real_depth.main(kitti, str(tmp_path / "small.yaml"), image_size=SIZE, epochs=1)
    printed = capsys.readouterr()
    assert "epoch 1/1: loss" in printed.err
    lines = [line.strip("| ").split(" | ") for line in printed.out.splitlines()]
    assert {len(cells) for cells in lines[2:]} == {9}
    assert [cells[:2] for cells in lines[2:-1]] == [
        [name, frames] for name, frames in zip(real_depth.PLACES.values(), ("40", "8", *"1111"), strict=True)
    ]
    figures = np.array([[float(cell.rstrip("%")) for cell in cells[2:]] for cells in lines[2:]])
    np.testing.assert_allclose(figures[-1], figures[2:6].mean(axis=0), atol=0.06)


def test_an_object_frame_keeps_its_calibration(kitti: Path, tmp_path: Path) -> None:
    real_depth.lay_out(kitti, tmp_path / "raw")
    points = scan(RNG)[:, :3].astype(np.float64) + np.array([40, 0, 0])
    xyz1 = np.hstack([points, np.ones((len(points), 1))])
    Tr, R0 = np.vstack([MATRICES["Tr_velo_to_cam"], [0, 0, 0, 1]]), np.eye(4)
    R0[:3, :3] = MATRICES["R0_rect"]
    u, v, w = MATRICES["P2"] @ R0 @ Tr @ xyz1.T  # as the object set's devkit says
    camera = read_camera(tmp_path / "raw/2012_01_02", 2)
    assert camera.T_cam_velo is not None
    pixels, depth_m = project(transform(camera.T_cam_velo, points), camera.K)
    np.testing.assert_allclose(pixels, np.stack([u / w, v / w], axis=1))
    np.testing.assert_allclose(depth_m, w)


def test_a_missing_frame_is_named(kitti: Path, tmp_path: Path) -> None:
    (kitti / "object/velodyne/000001.bin").unlink()
    with pytest.raises(InputError, match=r"object/velodyne/000001\.bin is missing: extract it there"):
        real_depth.lay_out(kitti, tmp_path / "raw")
