"""Running and fitting the encoder: examples of the fit, its loss, saved weights, threads."""

from pathlib import Path

import numpy as np
import pytest
import torch

from models.encoder.unified_encoder import build
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.camera.geometry import rays
from pipeline.perception.examples import Example, Examples, mirrored
from pipeline.perception.fit import depth_and_class_loss
from pipeline.perception.perceive import load, passes, read, save
from tests import street

DENSE, LIDAR, BARE, BLIND = [f"2026_01_01_drive_000{number}" for number in range(1, 5)]
SMALL = {"backbone": "small"}


@pytest.fixture(scope="module")
def ingest(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("ingest")
    street.write_drive(folder, DENSE, 4)
    street.write_drive(folder, LIDAR, 8, dense=False, lidar=True)
    street.write_drive(folder, BARE, 3, dense=False)
    street.write_drive(folder, BLIND, 3, lidar=True, images=False)
    return folder


@pytest.mark.parametrize(("drives", "missing"), [([BARE, BLIND], "depth or LiDAR"), ([LIDAR, BARE], "classes")])
def test_drives_without_targets_are_refused(ingest, drives, missing):
    with pytest.raises(InputError, match=f"no image of the training drives has {missing}"):
        Examples(ingest, drives, 10)


def test_frames_with_an_image_and_a_target_are_chosen(ingest):
    with Examples(ingest, [DENSE, LIDAR, BARE, BLIND], 12) as examples:
        assert examples.frames_per_drive == {DENSE: 4, LIDAR: 8, BARE: 0, BLIND: 0}
        np.testing.assert_array_equal(examples[1].cls, street.scene(1)[2])
        assert (examples[5].cls == classes.VOID).all()
        assert examples[5].depth_m.any()


@pytest.fixture
def example() -> Example:
    image, depth, cls = street.scene(3)
    return Example(image, street.CAMERA, depth.astype(np.float32), cls)


def test_mirroring_negates_the_rays_and_is_its_own_inverse(example):
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


def test_a_saved_encoder_loads_unchanged_and_its_file_is_deterministic(tmp_path):
    model = build(SMALL)
    save(tmp_path, SMALL, model.state_dict())
    assert read(tmp_path / "encoder.pt")[0] == SMALL
    loaded = load(tmp_path)
    assert not loaded.training
    for name, tensor in model.state_dict().items():
        assert torch.equal(tensor, loaded.state_dict()[name].cpu()), name
    save(tmp_path / "other", SMALL, loaded.state_dict())  # it runs with channels last
    assert (tmp_path / "other/encoder.pt").read_bytes() == (tmp_path / "encoder.pt").read_bytes()


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
