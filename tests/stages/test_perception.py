from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
import yaml

from models.encoder.unified_encoder import build
from pipeline.base import store
from pipeline.camera import classes
from pipeline.perception.perceive import save
from stages.perception import main
from tests import street
from tests.kitti_drive import write_png

SPLITS = {"2026_01_01_drive_0001": "train", "2026_01_03_drive_0001": "test"}
DENSE, BLIND = SPLITS
FRAMES = 5


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Drives with and without images, and an encoder that was never fitted."""
    root = tmp_path_factory.mktemp("perception")
    street.write_drive(root / "ingest", DENSE, FRAMES)
    street.write_drive(root / "ingest", BLIND, 2, dense=False, lidar=True, images=False)
    store.write_index(root / "ingest", SPLITS)
    torch.manual_seed(0)
    small = {"backbone": "small"}
    save(root / "encoder", small, build(small).state_dict())
    run(root, "perception", batch=4)
    return root


def run(root: Path, name: str, batch: int = 2, **settings: object) -> None:
    params = root / "params.yaml"
    params.write_text(yaml.safe_dump({"perception": {"batch": batch, **settings}}))
    assert main(root / "ingest", root / "encoder", root / name, params, workers=1) == root / name


def read(root: Path, drive: str = DENSE, name: str = "perception") -> dict[str, np.ndarray]:
    with store.DriveReader(root / name / f"{drive}.h5", stage="perception") as file:
        return {name: file[name] for name in ("frame", "time_s", "depth_m", "cls")}


def test_each_image_has_depth_and_classes(folder: Path) -> None:
    assert store.read_index(folder / "perception", stage="perception") == SPLITS
    content = read(folder)
    assert content["frame"].tolist() == list(range(FRAMES))
    assert (content["depth_m"].dtype, content["cls"].dtype) == (np.uint16, np.uint8)
    assert content["depth_m"].shape == content["cls"].shape == (FRAMES, *street.SIZE)
    np.testing.assert_array_equal(content["depth_m"] == 0, content["cls"] == classes.SKY)
    blind = read(folder, BLIND)
    assert blind["depth_m"].shape == blind["cls"].shape == (0, *street.SIZE)


def test_precomputed_files_are_matched_by_frame_number_and_scaled(tmp_path: Path) -> None:
    truth = [street.scene(frame)[1:] for frame in range(FRAMES)]
    for frame, (depth_m, cls) in enumerate(truth):
        write_png(tmp_path / f"made/{DENSE}/depth/{frame:010d}.png", np.rint(0.4 * depth_m * 256).astype(np.uint16))
        write_png(tmp_path / f"made/{DENSE}/cls/{frame:010d}.png", cls)
    street.write_drive(tmp_path / "ingest", DENSE, FRAMES)
    with h5py.File(tmp_path / f"ingest/{DENSE}.h5", "r+") as file:
        file["has_image"][:] = [1, 1, 0, 1, 1]
    store.write_index(tmp_path / "ingest", {DENSE: "test"})
    save(tmp_path / "encoder", {"backbone": "precomputed", "folder": str(tmp_path / "made")}, {})
    run(tmp_path, "perception", batch=3)
    content = read(tmp_path)
    assert content["frame"].tolist() == [0, 1, 3, 4]
    depth_m, cls = (np.stack([truth[frame][part] for frame in content["frame"]]) for part in (0, 1))
    np.testing.assert_array_equal(content["cls"], cls)
    np.testing.assert_array_equal(content["depth_m"], np.rint(0.4 * depth_m * 256))
    run(tmp_path, "perception", depth_scale="camera_height", camera_height_m=1.65)
    found = read(tmp_path)["depth_m"] / 256
    assert np.median(found[depth_m > 0] / depth_m[depth_m > 0]) == pytest.approx(1.0, rel=0.01)
