from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from models.encoder.backbones.rtmonodepth_s import SIZE, rtmonodepth_s
from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.geometry import scan_depth
from pipeline.camera.images import read_image, resized
from pipeline.kitti.raw import KittiDrive, read_scan
from pipeline.perception.perceive import perceive
from pipeline.perception.scores import depth_errors, eigen_crop
from pipeline.perception.weights import load_weights
from pipeline.settings.encoder import Weights

KITTI_K = torch.tensor([[[371.8, 0, 320], [0, 369.4, 92], [0, 0, 1]]], dtype=torch.float64)


def unified() -> UnifiedEncoder:
    torch.manual_seed(0)
    return UnifiedEncoder("rtmonodepth-s").eval()


def predict(model: UnifiedEncoder, image: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
    with torch.no_grad():
        return model(image, K)


def test_number_of_parameters_matches_the_published_files() -> None:
    sizes = [sum(parameter.numel() for parameter in part.parameters()) for part in rtmonodepth_s()]
    assert sizes[:2] == [858_048, 376_979 - 866]  # without the two coarser heads of its training
    assert sizes[2] == sum(parameter.numel() for parameter in UnifiedEncoder("espnetv2").backbone.parameters())


def test_depth_grows_with_the_focal_length() -> None:
    model, image = unified(), torch.rand(1, 3, *SIZE)
    longer = KITTI_K.clone()
    longer[:, :2, :2] *= 1.5
    depth, logits = predict(model, image, KITTI_K)
    other, same = predict(model, image, longer)
    torch.testing.assert_close(other, 1.5 * depth)
    torch.testing.assert_close(same, logits)
    assert (depth > 0.5).all()
    assert (depth < 550).all()


@pytest.mark.parametrize("size", [(96, 320), (188, 621), (41, 75)])
def test_an_image_of_any_size_is_resized_to_the_training_size(size: tuple[int, int]) -> None:
    model = unified()
    image = torch.rand(2, 3, *size)
    K = torch.from_numpy(Camera(KITTI_K[0].numpy(), SIZE).scaled(size).K).expand(2, 3, 3)
    depth, logits = predict(model, image, K)
    assert depth.shape == (2, *size)
    assert logits.shape == (2, classes.COUNT + 1, *size)
    enlarged = torch.nn.functional.interpolate(image, SIZE, mode="bilinear", antialias=True)
    whole, _ = predict(model, enlarged, KITTI_K.expand(2, 3, 3))
    torch.testing.assert_close(depth.log().mean(), whole.log().mean(), rtol=2e-2, atol=0)


def test_published_weights_of_espnetv2_give_its_classes() -> None:
    model, published = unified(), UnifiedEncoder("espnetv2").eval()
    model.class_head.load_state_dict(model.class_head.convert_names(published.backbone.state_dict()))
    image = torch.rand(2, 3, 60, 100)  # not a multiple of its strides
    K = KITTI_K.expand(2, 3, 3)
    torch.testing.assert_close(predict(model, image, K)[1], predict(published, image, K)[1], rtol=1e-3, atol=1e-4)


@pytest.mark.slow
@pytest.mark.real
def test_published_weights_give_metric_depth_of_real_streets(real_half: Path, real_weights: Path) -> None:
    model, folder = UnifiedEncoder("rtmonodepth-s").eval(), real_weights / "rtmonodepth-s"
    files = {"backbone": str(folder / "encoder.pth"), "depth_head": str(folder / "depth.pth")}
    load_weights(model, "rtmonodepth-s", Weights.model_validate(files))
    for drive, most in {"2011_09_26_drive_0005": 0.13, "2011_10_03_drive_0042": 0.17}.items():
        raw = KittiDrive(real_half / drive[:10] / f"{drive}_sync")
        number = raw.camera_number([2, 0])
        assert number is not None
        camera = raw.camera(number)
        scaled = camera.scaled(SIZE)
        errors, ratios = [], []
        for frame in list(raw.scans)[::10]:
            image = resized(read_image(raw.images(number)[frame], camera.size), SIZE)
            depth = perceive(model, image[None], scaled)[0][0]
            truth = scan_depth(read_scan(raw.scans[frame]), scaled)
            found = depth_errors(eigen_crop(depth), eigen_crop(truth))
            assert found is not None
            errors.append(found[0])
            ratios.append(np.median(truth[truth > 0] / depth[truth > 0]))
        assert np.mean(errors) < most
        assert np.mean(ratios) == pytest.approx(1, abs=0.08)  # metres, without any scaling
