from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.camera import geometry
from pipeline.camera.images import DEPTH_UNITS_PER_M
from pipeline.graphs import cloud
from pipeline.report import street_view
from tests import street

DRIVE = "2026_01_01_drive_0001"


def view(frame: int = 3) -> street_view.View:
    rgb, depth_m, cls = street.scene(frame)
    return street_view.View(frame, rgb, depth_m, cls, *cloud.pseudo_cloud(depth_m, cls, street.K, 80.0))


def test_a_view_is_read_by_frame_number(tmp_path: Path) -> None:
    """The three files hold the frame in different rows; each point projects to a pixel of its depth and class."""
    street.write_drive(tmp_path / "ingest", DRIVE, 5)
    street.write_perception(tmp_path / "perception", tmp_path / "ingest", DRIVE)
    with store.DriveWriter(tmp_path / "clouds.h5", stage="clouds", drive=DRIVE, params={}) as file:
        views = [view(frame) for frame in (1, 3, 4)]
        cloud.write(file, np.array([1, 3, 4]), np.zeros(3), [(one.xyz, one.points_cls) for one in views])
    with (
        store.DriveReader(tmp_path / f"ingest/{DRIVE}.h5", stage="ingest") as raw,
        store.DriveReader(tmp_path / f"perception/{DRIVE}.h5", stage="perception") as perceived,
        store.DriveReader(tmp_path / "clouds.h5", stage="clouds") as points,
    ):
        third = street_view.read_view(raw, perceived, points, 3)
        with pytest.raises(InputError, match="no frame 2"):
            street_view.read_view(raw, perceived, points, 2)
    np.testing.assert_array_equal(third.rgb, street.scene(3)[0])
    uv, z = geometry.project(third.xyz.astype(float), street.K)
    u, v = np.rint(uv).astype(int).T
    assert z == pytest.approx(third.depth_m[v, u], abs=0.5 / DEPTH_UNITS_PER_M)
    np.testing.assert_array_equal(third.points_cls, third.cls[v, u])
