from pathlib import Path

import numpy as np

from pipeline.encoder.precomputed import fingerprint, read
from tests.kitti_drive import write_png

DRIVE = "2011_09_26_drive_0001"


def test_files_of_another_size_are_sampled(tmp_path: Path) -> None:
    depth, cls = np.arange(48, dtype=np.uint16).reshape(6, 8) * 256, np.arange(48, dtype=np.uint8).reshape(6, 8) % 19
    cls[0, 0] = 255
    write_png(tmp_path / DRIVE / "depth/0000000007.png", depth)
    write_png(tmp_path / DRIVE / "cls/0000000007.png", cls)
    equal = read(tmp_path, DRIVE, 7, (6, 8))
    np.testing.assert_array_equal(equal[0], depth / 256)
    np.testing.assert_array_equal(equal[1], cls)
    smaller = read(tmp_path, DRIVE, 7, (2, 4))
    assert np.isin(smaller[0], depth / 256).all()
    assert smaller[0].shape == smaller[1].shape == (2, 4)


def test_the_fingerprint_depends_on_contents(tmp_path: Path) -> None:
    path = tmp_path / DRIVE / "cls/0000000000.png"
    write_png(path, np.zeros((4, 4), np.uint8))
    before, size = fingerprint(tmp_path), path.stat().st_size
    content = bytearray(path.read_bytes())
    content[-20] ^= 1
    path.write_bytes(content)
    assert path.stat().st_size == size
    assert fingerprint(tmp_path) != before
    assert fingerprint(tmp_path)[0] == 1
