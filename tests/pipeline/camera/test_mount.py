from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.mount import CAMERA_HEIGHT_M, camera_height
from pipeline.kitti.calibration import cameras_in, read_camera
from pipeline.town.rig import make_rig, write_calibration


def heights(folder: Path) -> list[float]:
    return [camera_height(read_camera(folder, number).T_cam_velo) for number in cameras_in(folder)]


@pytest.mark.parametrize(
    ("date", "height_m"), [("2026_01_01", 1.65), ("2026_01_04", 1.55), ("2026_01_05", 1.72), ("2026_01_06", 1.76)]
)
def test_heights_of_the_samples_cameras(tmp_path: Path, date: str, height_m: float) -> None:
    write_calibration(make_rig((188, 621), date), tmp_path)
    assert heights(tmp_path) == pytest.approx([height_m] * 4, abs=0.01)


def test_default_and_implausible_height() -> None:
    assert camera_height(None) == CAMERA_HEIGHT_M
    T_cam_velo = np.array([[0.0, -1, 0, 0], [0, 0, -1, -1.8], [1, 0, 0, 0], [0, 0, 0, 1]])
    with pytest.raises(InputError, match=r"-0\.07 m .*perception\.camera_height_m"):
        camera_height(T_cam_velo)
