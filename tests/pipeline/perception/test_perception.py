"""Encoders: weights, the fit, passes; depth in metres, ground truth, and errors of depth and classes."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch

from models.encoder.unified_encoder import build
from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.camera.camera import Camera, read_camera, scan_depth
from pipeline.camera.geometry import back_project, rays
from pipeline.camera.ground_plane import ground_plane_depth
from pipeline.encoder.create import create, fetch
from pipeline.encoder.encoder_file import save
from pipeline.encoder.examples import Example, Examples, mirrored
from pipeline.encoder.fit import depth_and_class_loss
from pipeline.encoder.settings import Encoder
from pipeline.ingest.truth import read_truth
from pipeline.perception.perceive import passes
from pipeline.perception.reach import limit_traffic_depth
from tests import street


def test_a_file_is_downloaded_once_and_verified(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("published.pth").write_bytes(b"some weights")
    sha256, url = hashlib.sha256(b"some weights").hexdigest(), Path("published.pth").resolve().as_uri()
    path = Path("weights/a/net.pth")
    with pytest.raises(InputError, match="cannot download file:"):
        fetch(path, url, "0" * 64)
    assert list(path.parent.iterdir()) == []
    fetch(path, url, sha256)
    Path("published.pth").unlink()
    fetch(path, url, sha256)
    assert [path.name for path in path.parent.iterdir()] == ["net.pth"]
    path.write_bytes(b"other")
    with pytest.raises(InputError, match=f"SHA-256 is .*, expected {sha256}"):
        fetch(path, url, sha256)


def test_an_encoder_of_another_kind_is_refused(tmp_path):
    save(tmp_path, SMALL, build(SMALL).state_dict())
    fit = {"epochs": 0, "frames": 1, "batch": 1, "learning_rate": 0.1, "seed": 0}
    with pytest.raises(InputError, match="backbone is 'small', expected 'street'"):
        create(Encoder(backbone="street", weights=tmp_path / "encoder.pt", **fit))


DENSE, LIDAR, BARE, BLIND = [f"2026_01_01_drive_000{number}" for number in range(1, 5)]
SMALL = {"backbone": "small"}


def test_frames_with_an_image_and_a_target_are_chosen(tmp_path):
    street.write_drive(tmp_path, DENSE, 4)
    street.write_drive(tmp_path, LIDAR, 8, dense=False, lidar=True)
    street.write_drive(tmp_path, BARE, 3, dense=False)
    street.write_drive(tmp_path, BLIND, 3, lidar=True, images=False)
    for drives, missing in (([BARE, BLIND], "depth or LiDAR"), ([LIDAR, BARE], "classes")):
        with pytest.raises(InputError, match=f"no image of the training drives has {missing}"):
            Examples(tmp_path, drives, 10)
    with Examples(tmp_path, [DENSE, LIDAR, BARE, BLIND], 12) as examples:
        assert examples.frames_per_drive == {DENSE: 4, LIDAR: 8}
        np.testing.assert_array_equal(examples[1].cls, street.scene(1)[2])
        assert (examples[5].cls == classes.VOID).all()
        assert examples[5].depth_m.any()


def test_mirroring_negates_the_rays_and_is_its_own_inverse():
    image, depth, cls = street.scene(3)
    example = Example(image, street.CAMERA, depth.astype(np.float32), cls)
    mirror = mirrored(example)
    x, y, _ = np.moveaxis(rays(street.K, street.SIZE), -1, 0)
    mirror_x, mirror_y, _ = np.moveaxis(rays(mirror.camera.K, street.SIZE), -1, 0)
    np.testing.assert_allclose(mirror_x, -x[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(mirror_y, y)
    np.testing.assert_array_equal(mirror.depth_m, example.depth_m[:, ::-1])
    back = mirrored(mirror)
    np.testing.assert_allclose(back.camera.K, street.K)
    for name in ("image", "depth_m", "cls"):
        np.testing.assert_array_equal(getattr(back, name), getattr(example, name))


def test_the_loss_ignores_unknown_pixels_and_matches_hand_values():
    logits = torch.zeros(1, 19, 1, 3)
    logits[0, 3, 0, 0] = 50.0
    depth, true_depth = torch.tensor([[[2.0, 8.0, 5.0]]]), torch.tensor([[[4.0, 8.0, 0.0]]])
    loss = depth_and_class_loss(depth, logits, true_depth, torch.tensor([[[3, 255, 7]]]))
    np.testing.assert_allclose(loss, [(np.log(2) / 2 + 0.5 / 2) / 2, np.log(19) / 2], rtol=1e-5)


def test_passes_give_the_same_bits_for_any_number_of_threads(monkeypatch):
    monkeypatch.setenv("STEER_WORKERS", "5")
    matrices = np.random.default_rng(0).standard_normal((6, 300, 300), np.float32)

    def forward(matrix: np.ndarray) -> np.ndarray:
        assert torch.get_num_threads() == 1
        return (torch.from_numpy(matrix) @ torch.from_numpy(matrix)).sum(0).numpy()

    results, before = [], torch.get_num_threads()
    for threads in (1, 5):
        torch.set_num_threads(threads)
        results.append(np.stack(list(passes(forward, (matrix for matrix in matrices)))))
        assert torch.get_num_threads() == threads
    torch.set_num_threads(before)
    np.testing.assert_array_equal(*results)


def test_ground_is_a_plane_and_objects_have_the_depth_of_their_foot():
    _, truth, cls = street.scene(0)
    depth = ground_plane_depth(cls, street.CAMERA)
    ground = cls == classes.ROAD
    np.testing.assert_allclose(back_project(depth, street.K)[ground][:, 1], 1.65)
    np.testing.assert_allclose(depth[ground], truth[ground])
    # The street's walls are upright, so each wall pixel is as far as the first road pixel below it, or nearer.
    for column in range(0, street.SIZE[1], 7):
        foot = np.flatnonzero(ground[:, column])[:1]
        if foot.size:
            np.testing.assert_allclose(depth[: foot[0], column], depth[foot[0], column])


def test_only_traffic_is_limited():
    _, truth, cls = street.scene(0)
    cls = cls.copy()
    column = np.flatnonzero((cls == classes.ROAD).any(axis=0) & (cls == classes.BUILDING).any(axis=0))[0]
    lorry = np.zeros(cls.shape, bool)
    lorry[:, column] = cls[:, column] == classes.BUILDING
    cls[lorry] = classes.TRUCK
    depth = np.where(lorry, 70.0, truth)
    limit_traffic_depth(depth, cls, street.CAMERA, reach=1.1)
    np.testing.assert_array_equal(depth[~lorry], truth[~lorry])
    np.testing.assert_allclose(depth[lorry], 1.1 * ground_plane_depth(cls, street.CAMERA)[lorry])
    near = np.where(lorry, 2.0, truth)
    limit_traffic_depth(near, cls, street.CAMERA, reach=1.1)
    assert (near[lorry] == 2.0).all()


@pytest.mark.parametrize("dense", [True, False])
def test_dense_truth_precedes_lidar_which_is_sparse_and_has_no_classes(tmp_path, dense):
    street.write_drive(tmp_path, DENSE, 2, dense=dense, lidar=True)
    _, depth, cls = street.scene(1)
    with store.DriveReader(tmp_path / f"{DENSE}.h5", stage="ingest") as file:
        truth = read_truth(file, read_camera(file), 1)
    hit = np.zeros(street.SIZE, bool)
    hit[::2, ::4] = True
    np.testing.assert_allclose(truth.depth_m, np.where(hit | dense, depth, 0), rtol=1e-4, atol=0.5 / 256 + 1e-6)
    np.testing.assert_array_equal(truth.cls, cls if dense else classes.VOID)
    assert truth.depth_source == ("dense" if dense else "lidar")


def test_hidden_points_are_dropped_and_ground_stays():
    camera = Camera(np.array([[360.0, 0, 160], [0, 360, 40], [0, 0, 1]]), (100, 320), T_cam_velo=np.eye(4))
    rows = np.arange(100)[:, None]
    ground = np.where(rows > 45, 1.65 * 360 / np.maximum(rows - 40, 1), 0) * np.ones((1, 320))
    ground[:, 1::3] = 0
    wall = ground.copy()
    wall[20:80:2, 100:140:2] = 6.0  # a car, and street points behind it between its own
    kept, ground_kept = (scan_depth(back_project(depth, camera.K)[depth > 0], camera) for depth in (wall, ground))
    np.testing.assert_allclose(ground_kept, ground, rtol=1e-6)
    np.testing.assert_allclose(kept[20:80:2, 100:140:2], 6.0)
    hidden = np.zeros_like(wall, bool)
    hidden[46:79, 100:139] = wall[46:79, 100:139] > 7.5
    assert hidden.any()
    assert not kept[hidden].any()
    np.testing.assert_array_equal(kept[:, :98], ground_kept[:, :98])
