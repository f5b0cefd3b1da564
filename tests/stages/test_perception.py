"""Stage perception by precomputed files; tests/test_chain.py runs it with a network."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml

from pipeline.base import store
from pipeline.perception.perceive import save
from stages.perception import main
from tests import street
from tests.kitti_drive import write_png

DRIVE = "2026_01_01_drive_0001"
FRAMES = 5


def run(root: Path, **settings: object) -> dict[str, np.ndarray]:
    params = root / "params.yaml"
    params.write_text(yaml.safe_dump({"perception": {"batch": 3, **settings}}))
    folder = main(root / "ingest", root / "encoder", root / "perception", params)
    with store.DriveReader(folder / f"{DRIVE}.h5", stage="perception") as file:
        return {name: file[name] for name in ("frame", "depth_m", "cls")}


def test_precomputed_files_are_matched_by_frame_number_and_scaled(tmp_path):
    truth = [street.scene(frame)[1:] for frame in range(FRAMES)]
    for frame, (depth_m, cls) in enumerate(truth):
        write_png(tmp_path / f"made/{DRIVE}/depth/{frame:010d}.png", np.rint(0.4 * depth_m * 256).astype(np.uint16))
        write_png(tmp_path / f"made/{DRIVE}/cls/{frame:010d}.png", cls)
    street.write_drive(tmp_path / "ingest", DRIVE, FRAMES)
    with h5py.File(tmp_path / f"ingest/{DRIVE}.h5", "r+") as file:
        file["has_image"][:] = [1, 1, 0, 1, 1]
    store.write_index(tmp_path / "ingest", {DRIVE: "test"})
    save(tmp_path / "encoder", {"backbone": "precomputed", "folder": str(tmp_path / "made")}, {})
    content = run(tmp_path)
    assert content["frame"].tolist() == [0, 1, 3, 4]
    depth_m, cls = (np.stack([truth[frame][part] for frame in content["frame"]]) for part in (0, 1))
    np.testing.assert_array_equal(content["cls"], cls)
    np.testing.assert_array_equal(content["depth_m"], np.rint(0.4 * depth_m * 256))
    found = run(tmp_path, depth_scale="camera_height", camera_height_m=1.65)["depth_m"] / 256
    assert np.median(found[depth_m > 0] / depth_m[depth_m > 0]) == pytest.approx(1.0, rel=0.01)
