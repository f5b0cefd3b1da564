"""Weights, frames and loss of the encoder's fit; and which frames have ground truth."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch

from models.encoder.unified_encoder import build_network
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.camera.geometry import camera_rays
from pipeline.encoder.create import create_encoder, download_file
from pipeline.encoder.encoder_file import save_encoder
from pipeline.encoder.examples import Example, Examples, augment_example, mirror_example
from pipeline.encoder.fit import depth_and_class_loss
from pipeline.encoder.settings import Encoder
from tests import street

SMALL = {"backbone": "small"}
DENSE = "2026_01_01_drive_0001"
LIDAR = "2026_01_01_drive_0002"
BARE = "2026_01_01_drive_0003"
BLIND = "2026_01_01_drive_0004"


def test_a_file_is_downloaded_once_and_verified(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("published.pth").write_bytes(b"some weights")
    url = Path("published.pth").resolve().as_uri()
    sha256 = hashlib.sha256(b"some weights").hexdigest()
    path = Path("weights/a/net.pth")
    with pytest.raises(InputError, match="cannot download file:"):
        download_file(path, url, "0" * 64)
    assert list(path.parent.iterdir()) == []
    download_file(path, url, sha256)
    Path("published.pth").unlink()
    download_file(path, url, sha256)
    assert [path.name for path in path.parent.iterdir()] == ["net.pth"]
    path.write_bytes(b"other")
    with pytest.raises(InputError, match=f"SHA-256 is .*, expected {sha256}"):
        download_file(path, url, sha256)


def test_an_encoder_of_another_kind_is_refused(tmp_path):
    save_encoder(tmp_path, SMALL, build_network(SMALL).state_dict())
    fit = {"epochs": 0, "frames": 1, "batch": 1, "learning_rate": 0.1, "seed": 0}
    with pytest.raises(InputError, match="backbone is 'small', expected 'street'"):
        create_encoder(Encoder(backbone="street", weights=tmp_path / "encoder.pt", **fit))


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
    mirror = mirror_example(example)
    x, y, _ = np.moveaxis(camera_rays(street.K, street.SIZE), -1, 0)
    mirror_x, mirror_y, _ = np.moveaxis(camera_rays(mirror.camera.K, street.SIZE), -1, 0)
    np.testing.assert_allclose(mirror_x, -x[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(mirror_y, y)
    np.testing.assert_array_equal(mirror.depth_m, example.depth_m[:, ::-1])
    back = mirror_example(mirror)
    np.testing.assert_allclose(back.camera.K, street.K)
    for name in ("image", "depth_m", "cls"):
        np.testing.assert_array_equal(getattr(back, name), getattr(example, name))


@pytest.mark.parametrize("seed", range(4))
def test_augmentation_changes_colours_and_mirrors_but_moves_no_target(seed):
    """Equal seeds give equal images; darker pixels stay darker."""
    image, depth, cls = street.scene(3)
    example = Example(image, street.CAMERA, depth.astype(np.float32), cls)
    changed = augment_example(example, np.random.default_rng(seed))
    again = augment_example(example, np.random.default_rng(seed))
    np.testing.assert_array_equal(changed.image, again.image)

    plain = example
    if not np.array_equal(changed.cls, cls):
        plain = mirror_example(example)
    np.testing.assert_array_equal(changed.cls, plain.cls)
    np.testing.assert_array_equal(changed.depth_m, plain.depth_m)
    np.testing.assert_allclose(changed.camera.K, plain.camera.K)
    grey = np.ptp(changed.image, axis=-1).max() == 0
    for before, after in zip(plain.image.T, changed.image.T, strict=True):
        darkest_first = np.argsort(before, axis=None, kind="stable")
        assert grey or (np.diff(after.ravel()[darkest_first].astype(int)) >= 0).all()


def test_the_loss_ignores_unknown_pixels_and_matches_hand_values():
    logits = torch.zeros(1, 19, 1, 3)
    logits[0, 3, 0, 0] = 50.0
    depth = torch.tensor([[[2.0, 8.0, 5.0]]])
    true_depth = torch.tensor([[[4.0, 8.0, 0.0]]])
    true_cls = torch.tensor([[[3, 255, 7]]])
    loss = depth_and_class_loss(depth, logits, true_depth, true_cls)
    np.testing.assert_allclose(loss, [(np.log(2) / 2 + 0.5 / 2) / 2, np.log(19) / 2], rtol=1e-5)
