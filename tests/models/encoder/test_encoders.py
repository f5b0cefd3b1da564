"""Published networks of real streets against truth and formulas."""

import cv2
import numpy as np
import pytest
import torch
from torch import nn

from models.encoder.efficientvit import HEAD_WIDTH, LinearAttention
from models.encoder.rtmonodepth_s import SIZE
from models.encoder.street import Street
from pipeline.camera import classes
from pipeline.camera.camera import Camera, scan_depth
from pipeline.camera.images import read_image, resized
from pipeline.kitti.raw import KittiDrive, read_scan
from pipeline.perception.perceive import perceive
from pipeline.perception.scores import class_ious, confusion, depth_errors, eigen_crop

K = torch.tensor([[[50.0, 0.0, 30.0], [0.0, 40.0, 20.0], [0.0, 0.0, 1.0]]], dtype=torch.float64)


def test_depth_of_streets_grows_with_the_focal_length_and_classes_do_not():
    torch.manual_seed(0)
    model, longer = Street().eval(), K.clone()
    longer[:, :2, :2] *= 1.5
    image = torch.rand(1, 3, 41, 75)
    with torch.no_grad():
        (depth, logits), (other, same) = model(image, K), model(image, longer)
    torch.testing.assert_close(other, 1.5 * depth)
    torch.testing.assert_close(same, logits)


def test_linear_attention_is_a_mean_of_values_weighted_by_products_of_keys_and_queries():
    torch.manual_seed(0)
    layer = LinearAttention(2 * HEAD_WIDTH).eval()
    layer.proj = nn.Identity()
    x = torch.randn(2, 2 * HEAD_WIDTH, 3, 5)
    with torch.no_grad():
        qkv = layer.qkv(x)
        for head, part in enumerate(torch.cat([qkv, layer.aggreg[0](qkv)], dim=1).split(3 * HEAD_WIDTH, dim=1)):
            q, k, v = part.flatten(2).split(HEAD_WIDTH, dim=1)  # [2,16,15]
            weights = torch.einsum("bcn,bcm->bnm", k.relu(), q.relu())
            expected = torch.einsum("bcn,bnm->bcm", v, weights / weights.sum(dim=1, keepdim=True))
            got = layer(x)[:, head * HEAD_WIDTH : (head + 1) * HEAD_WIDTH].flatten(2)
            torch.testing.assert_close(got, expected, rtol=1e-4, atol=1e-5)


def grey(image: np.ndarray) -> np.ndarray:
    return np.repeat(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=-1)


@pytest.fixture(scope="module")
def street(real_weights) -> nn.Module:
    model = Street()
    model.load_published(real_weights)  # all tensors have to agree
    return model.eval()


@pytest.mark.slow
@pytest.mark.real
@pytest.mark.parametrize(("drive", "most"), [("2011_09_26_drive_0005", 0.13), ("2011_10_03_drive_0042", 0.17)])
def test_published_weights_give_metric_depth_of_real_streets(street, real_half, drive, most):
    raw = KittiDrive(real_half / drive[:10] / f"{drive}_sync")
    number = raw.camera_number([2, 0])
    camera = raw.camera(number)
    scaled = camera.scaled(SIZE)
    errors, ratios, matrix = [], [], np.zeros((classes.COUNT, classes.COUNT + 1), int)
    for frame in list(raw.scans)[::10]:
        image = resized(read_image(raw.images(number)[frame], camera.size), SIZE)
        depth, cls = perceive(street, image[None], scaled)
        truth = scan_depth(read_scan(raw.scans[frame]), scaled)
        found = depth_errors(eigen_crop(depth[0]), eigen_crop(truth))
        errors.append(found[0])
        ratios.append(np.median(truth[truth > 0] / depth[0][truth > 0]))
        matrix += confusion(perceive(street, grey(image)[None], scaled)[1][0], cls[0])
    assert np.mean(errors) < most
    assert np.mean(ratios) == pytest.approx(1, abs=0.08)  # metres, without any scaling
    ious = class_ious(matrix)  # of grey against colour
    assert (ious[[classes.ROAD, classes.SIDEWALK, classes.BUILDING, classes.VEGETATION]] > [0.9, 0.8, 0.88, 0.78]).all()


# CamVid's label (0 sky, 1 building, 2 pole, 3 road, 4 pavement, 5 tree, 6 sign, 7 fence, 8 car, 9 pedestrian,
# 10 bicyclist) of Cityscapes' classes; it has no wall, train and void.
VOID = classes.VOID
CAMVID = np.array([3, 4, 1, VOID, 7, 2, 6, 6, 5, 5, 0, 9, 10, 8, 8, 8, VOID, 10, 10])


@pytest.mark.slow
@pytest.mark.real
@pytest.mark.parametrize(("colour", "least"), [(True, 0.65), (False, 0.62)])
def test_published_weights_give_classes_of_camvids_streets(street, real_camvid, colour, least):
    matrix, camera = 0, Camera(np.array([[400.0, 0, 240], [0, 400, 180], [0, 0, 1]]), (360, 480))
    for path in sorted((real_camvid / "images").glob("*.jpg"))[::3]:
        label = cv2.imread(str(real_camvid / f"labels/{path.stem}.png"), cv2.IMREAD_UNCHANGED)
        image = read_image(path, camera.size)
        cls = perceive(street, (image if colour else grey(image))[None], camera)[1][0]
        matrix += confusion(CAMVID[cls], np.where(label < 11, label, VOID))
    assert class_ious(matrix)[:11].mean() > least
