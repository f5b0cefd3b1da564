import threading
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base import pool, store
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.encoder.perceive import save
from pipeline.kitti.ingest_file import put_camera, put_motion, put_pixels, put_scans
from pipeline.kitti.oxts import make_rows
from stages.perception import main
from tests import street
from tests.kitti_drive import write_png

SPLITS = {"2026_01_01_drive_0001": "train", "2026_01_03_drive_0001": "test", "2026_01_03_drive_0002": "test"}
DENSE, LIDAR, BLIND = SPLITS


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Drives with dense truth, with LiDAR alone and without images, and a network that was never fitted."""
    root = tmp_path_factory.mktemp("perception")
    street.write_drive(root / "ingest", DENSE, 7)
    street.write_drive(root / "ingest", LIDAR, 5, dense=False, lidar=True)
    street.write_drive(root / "ingest", BLIND, 3, dense=False, lidar=True, images=False)
    store.write_index(root / "ingest", SPLITS)
    torch.manual_seed(0)
    save(root / "encoder", "small", UnifiedEncoder("small").state_dict())
    run(root, "perception", batch=4)
    return root


def run(root: Path, name: str, batch: int, workers: int = 1, **settings: object) -> None:
    params = root / "params.yaml"
    params.write_text(yaml.safe_dump({"perception": {"batch": batch, **settings}}))
    assert main(root / "ingest", root / "encoder", root / name, params, workers) == root / name


def read(path: Path) -> dict[str, np.ndarray]:
    with store.DriveReader(path, stage="perception") as file:
        return {name: file[name] for name in ("frame", "time_s", "depth_m", "cls")}


def test_each_image_has_depth_and_classes(folder: Path) -> None:
    assert store.read_index(folder / "perception", stage="perception") == SPLITS
    content = read(folder / "perception" / f"{DENSE}.h5")
    assert content["frame"].tolist() == list(range(7))
    assert content["depth_m"].dtype == np.uint16
    assert content["cls"].dtype == np.uint8
    assert content["depth_m"].shape == content["cls"].shape == (7, *street.SIZE)
    np.testing.assert_array_equal(content["depth_m"] == 0, content["cls"] == classes.SKY)


def test_a_drive_without_images_gives_an_empty_file(folder: Path) -> None:
    content = read(folder / "perception" / f"{BLIND}.h5")
    assert content["depth_m"].shape == content["cls"].shape == (0, *street.SIZE)
    assert content["frame"].dtype == np.int32


def test_only_frames_with_an_image_count_or_are_read(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    street.write_drive(tmp_path / "ingest", DENSE, 7)
    import h5py

    with h5py.File(tmp_path / "ingest" / f"{DENSE}.h5", "r+") as file:
        file["has_image"][2:5] = 0
    store.write_index(tmp_path / "ingest", {DENSE: "train"})
    (tmp_path / "encoder").symlink_to(folder / "encoder")
    row, rows_read = store.DriveReader.row, []
    monkeypatch.setattr(
        store.DriveReader,
        "row",
        lambda self, name, index: (rows_read.append(index) if name == "image" else None) or row(self, name, index),
    )
    run(tmp_path, "perception", batch=3)
    assert rows_read == [0, 1, 5, 6]
    some, every = read(tmp_path / "perception" / f"{DENSE}.h5"), read(folder / "perception" / f"{DENSE}.h5")
    assert some["frame"].tolist() == [0, 1, 5, 6]
    np.testing.assert_allclose(some["depth_m"].astype(int), every["depth_m"][[0, 1, 5, 6]], atol=1)


def test_batch_size_changes_nothing_and_a_drive_without_images_is_named(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(folder, "single", batch=1)
    assert f"without images, so without depth and classes: {BLIND}" in capsys.readouterr().out
    for drive in SPLITS:
        one, four = read(folder / "single" / f"{drive}.h5"), read(folder / "perception" / f"{drive}.h5")
        assert (one["cls"] == four["cls"]).mean() > 0.999 if four["cls"].size else not one["cls"].size
        same = one["cls"] == four["cls"]
        np.testing.assert_allclose(one["depth_m"][same].astype(int), four["depth_m"][same], atol=1)


def test_half_precision_products_change_little(folder: Path) -> None:
    run(folder, "halves", batch=4, precision="bfloat16")
    halves, full = read(folder / "halves" / f"{DENSE}.h5"), read(folder / "perception" / f"{DENSE}.h5")
    assert (halves["depth_m"] != full["depth_m"]).any()
    both = (halves["depth_m"] > 0) & (full["depth_m"] > 0)
    np.testing.assert_allclose(halves["depth_m"][both] / full["depth_m"][both], 1, atol=0.02)
    assert (halves["cls"] == full["cls"]).mean() > 0.95


def test_a_bad_checkpoint_is_one_error_that_names_the_command(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "encoder").mkdir()
    (tmp_path / "encoder" / "encoder.pt").write_bytes(b"nothing")
    (tmp_path / "ingest").symlink_to(folder / "ingest")
    with pytest.raises(InputError, match=r"cut short.*dvc repro --force --single-item encoder"):
        run(tmp_path, "perception", batch=1)


@pytest.mark.slow
def test_the_same_bytes_for_any_workers_threads_and_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size, frames = (96, 320), 5  # at which one pass on several threads has other bytes
    images = np.random.default_rng(0).integers(0, 256, (frames, *size, 3), np.uint8)
    for drive in (DENSE, LIDAR):
        with store.DriveWriter(tmp_path / f"ingest/{drive}.h5", stage="ingest", drive=drive, params={}) as file:
            put_motion(file, np.arange(frames), np.arange(frames) / 10, make_rows(frames))
            put_camera(file, street.K, None)
            put_pixels(file, "image", frames, size, enumerate(images))
            put_scans(file, frames, ())
    store.write_index(tmp_path / "ingest", {DENSE: "train", LIDAR: "test"})
    torch.manual_seed(1)
    save(tmp_path / "encoder", "small", UnifiedEncoder("small").state_dict())
    before = torch.get_num_threads()
    monkeypatch.setenv("STEER_WORKERS", "4")  # cores, of which each of two workers has its share
    for name, workers, threads, block in (("one", 1, 1, 32), ("side", 1, 3, 32), ("two", 2, 1, 2), ("three", 3, 1, 4)):
        monkeypatch.setattr(pool, "BLOCK_FRAMES", block)
        torch.set_num_threads(threads)
        try:
            run(tmp_path, name, batch=2, workers=workers)
        finally:
            torch.set_num_threads(before)
    for drive in (DENSE, LIDAR):
        contents = {(tmp_path / name / f"{drive}.h5").read_bytes() for name in ("one", "side", "two", "three")}
        assert len(contents) == 1, drive


def write_precomputed(root: Path, factor: float = 1.0) -> None:
    """The truth of drive DENSE as PNG files, its depth in another unit."""
    for frame in range(7):
        _, depth, cls = street.scene(frame)
        write_png(
            root / "made" / DENSE / "depth" / f"{frame:010d}.png", np.rint(factor * depth * 256).astype(np.uint16)
        )
        write_png(root / "made" / DENSE / "cls" / f"{frame:010d}.png", cls)
    street.write_drive(root / "ingest", DENSE, 7, lidar=True)
    store.write_index(root / "ingest", {DENSE: "test"})
    config = {"backbone": "precomputed", "weights": str(root / "made")}
    store.write_json(root / "encoder" / "config.json", config)


def test_precomputed_files_go_where_their_frames_are(tmp_path: Path) -> None:
    write_precomputed(tmp_path)
    run(tmp_path, "perception", batch=3)
    content = read(tmp_path / "perception" / f"{DENSE}.h5")
    for frame in range(7):
        _, depth, cls = street.scene(frame)
        np.testing.assert_array_equal(content["cls"][frame], cls)
        np.testing.assert_array_equal(content["depth_m"][frame], np.rint(depth * 256))
    (tmp_path / "made" / DENSE / "cls" / "0000000004.png").unlink()
    with pytest.raises(InputError, match=r"cls/0000000004\.png is missing") as caught:  # a traceback keeps generators
        run(tmp_path, "again", batch=1)
    assert caught.tb
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("prefetch")]


@pytest.mark.parametrize(("mode", "expected"), [("camera_height", 1.0), ("lidar_median", 1.0), ("none", 0.4)])
def test_depth_of_another_unit_gets_its_scale(tmp_path: Path, mode: str, expected: float) -> None:
    write_precomputed(tmp_path, factor=0.4)
    run(tmp_path, "perception", batch=3, depth_scale=mode, camera_height_m=1.65)
    found = read(tmp_path / "perception" / f"{DENSE}.h5")["depth_m"].astype(float)
    truth = np.stack([street.scene(frame)[1] for frame in range(7)]) * 256
    assert np.median(found[truth > 0] / truth[truth > 0]) == pytest.approx(expected, rel=0.01)
    with store.DriveReader(tmp_path / "perception" / f"{DENSE}.h5", stage="perception") as file:
        assert ("unknown unit" in file.dataset("depth_m").attrs["unit"]) == (mode == "none")


def test_a_frame_that_does_not_tell_its_scale_has_that_of_the_frame_before_whatever_the_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_precomputed(tmp_path, factor=0.4)
    import h5py

    with h5py.File(tmp_path / "ingest" / f"{DENSE}.h5", "r+") as file:
        file["has_lidar"][:] = [0, 1, 0, 0, 0, 1, 0]
    contents = []
    for name, size in (("whole", 32), ("one", 1), ("two", 2)):
        monkeypatch.setattr(pool, "BLOCK_FRAMES", size)
        run(tmp_path, name, batch=1, depth_scale="lidar_median")
        contents.append((tmp_path / name / f"{DENSE}.h5").read_bytes())
    assert contents[0] == contents[1] == contents[2]
    depth = read(tmp_path / "whole" / f"{DENSE}.h5")["depth_m"]
    assert [frame.any() for frame in depth] == [False, *[True] * 6]


def test_the_median_of_lidar_is_that_of_the_scan_not_of_dense_truth(tmp_path: Path) -> None:
    write_precomputed(tmp_path, factor=0.4)
    street.write_drive(tmp_path / "ingest", DENSE, 7)  # dense truth alone
    run(tmp_path, "perception", batch=3, depth_scale="lidar_median")
    assert not read(tmp_path / "perception" / f"{DENSE}.h5")["depth_m"].any()


def test_the_cameras_height_is_the_calibrations_or_the_one_that_the_params_say(folder: Path, tmp_path: Path) -> None:
    for name in ("ingest", "encoder"):
        (tmp_path / name).symlink_to(folder / name)
    for camera_height_m, expected in ((None, {DENSE: 1.65, LIDAR: 1.73 - 0.1}), (1.4, {DENSE: 1.4, LIDAR: 1.4})):
        run(tmp_path, "perception", batch=4, camera_height_m=camera_height_m)
        for drive, height_m in expected.items():
            with store.DriveReader(tmp_path / "perception" / f"{drive}.h5", stage="perception") as file:
                assert file.attrs["camera_height_m"] == pytest.approx(height_m)


def test_reach_without_metres_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="reach is of depth in metres"):
        run(folder, "none", batch=4, depth_scale="none", reach=1.1)
