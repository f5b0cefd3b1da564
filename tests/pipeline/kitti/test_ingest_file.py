"""The ingest file, written piece by piece."""

from pathlib import Path

import numpy as np

from pipeline.base.store import DriveReader, DriveWriter
from pipeline.camera.classes import VOID
from pipeline.kitti.ingest_file import put_camera, put_motion, put_pixels, put_scans
from pipeline.kitti.oxts import COLUMNS, VF, make_rows

SIZE = (4, 6)


def test_absent_rows_are_empty_and_flagged(tmp_path: Path) -> None:
    scan, cls = np.ones((5, 4), np.float32), np.full(SIZE, 3, np.uint8)
    with DriveWriter(tmp_path / "a.h5", stage="ingest", drive="drive", params={}) as writer:
        put_motion(writer, [7, 8, 10], np.array([0.0, 0.1, 0.3]), make_rows(3, vf=np.array([1.0, 2.0, 3.0])))
        put_camera(writer, np.eye(3), None)
        assert put_pixels(writer, "image", 3, SIZE, None) == 0
        assert put_pixels(writer, "depth", 3, SIZE, None) == 0
        assert put_pixels(writer, "cls", 3, SIZE, [(2, cls)]) == 1
        assert put_scans(writer, 3, [(0, scan), (2, scan[:2])]) == 2
    with DriveReader(tmp_path / "a.h5", stage="ingest") as file:
        assert (file.frame.tolist(), file.frame.dtype) == ([7, 8, 10], np.int32)
        assert file["oxts"][:, VF].tolist() == [1, 2, 3]
        assert file.shape("oxts") == (3, len(COLUMNS))
        assert "T_cam_velo" not in file
        assert file.shape("image") == (3, *SIZE, 3), "its size is stored without images"
        assert "depth" not in file
        assert (file["cls"][:2] == VOID).all()
        np.testing.assert_array_equal(file["cls"][2], cls)
        assert [file[f"has_{name}"].tolist() for name in ("image", "depth", "cls", "lidar")] == [
            [0, 0, 0], [0, 0, 0], [0, 0, 1], [1, 0, 1],
        ]  # fmt: skip
        assert file["lidar_ptr"].tolist() == [0, 5, 5, 7]
