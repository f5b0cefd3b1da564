from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from models.encoder.backbones.espnetv2 import espnetv2
from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.camera import classes
from pipeline.camera.geometry import project, scale_K, transform
from pipeline.camera.images import read_image
from pipeline.encoder.perceive import perceive
from pipeline.encoder.weights import fill
from pipeline.kitti.raw import RawDrive, read_scan
from pipeline.sections.encoder import Weights

FILES = {"espnetv2": "espnetv2_s_2.0_city_1024x512.pth", "espnetv2-s1": "espnetv2_s_1.0_city_512x256.pth"}
SIZE = (192, 640)
GROUND = (classes.ROAD, classes.SIDEWALK, classes.TERRAIN)


@pytest.mark.parametrize(("scale", "numbers"), [(1.0, 247_279), (2.0, 814_351)])
def test_number_of_parameters_matches_the_published_files(scale: float, numbers: int) -> None:
    assert sum(tensor.numel() for tensor in espnetv2(scale).backbone.state_dict().values()) == numbers


def test_an_image_of_any_size_is_padded_with_its_edges() -> None:
    torch.manual_seed(0)
    backbone, _, class_head = espnetv2(1.0)
    backbone.eval()
    image = torch.randn(1, 3, 41, 75)
    whole = F.pad(image, (0, 5, 0, 7), mode="replicate")
    with torch.no_grad():
        features, continued = (backbone(x, torch.zeros(1, 2, *x.shape[-2:])) for x in (image, whole))
        logits = class_head(features, torch.zeros(1, 2, 41, 75))
    assert features.decoded.shape[-2:] == features.logits.shape[-2:] == (24, 40)
    for a, b in zip(features, continued, strict=True):
        torch.testing.assert_close(a, b)
    assert logits.shape == (1, 20, 41, 75)
    torch.testing.assert_close(logits[..., 0, 0], features.logits[..., 0, 0])  # corners fall on corners


@pytest.mark.real
@pytest.mark.parametrize("name", list(FILES))
def test_published_weights_classify_real_streets(name: str, real_kitti: Path, real_weights: Path) -> None:
    """No frame has class labels, but LiDAR separates ground from objects, and the sky has no points."""
    model = UnifiedEncoder(name).eval()
    fill(model, name, Weights.model_validate({"backbone": str(real_weights / "espnetv2" / FILES[name])}))
    on_ground, on_objects, in_sky = [], [], []
    for drive, frames in {"0001": [5], "0052": [0, 24, 47]}.items():
        raw = RawDrive(real_kitti / "2011_09_26" / f"2011_09_26_drive_{drive}_sync")
        camera = raw.camera([2])
        assert camera is not None
        K = scale_K(camera.K, camera.size, SIZE)
        for frame in frames:
            image = read_image(raw.images(2)[frame], camera.size, SIZE)
            cls = perceive(model, image[None], K)[1][0]
            xyz = read_scan(raw.scans[frame])[:, :3].astype(float)
            uv, z = project(transform(camera.T_cam_velo, xyz), K)
            seen = (z > 3) & (uv >= 0).all(axis=1) & (uv < np.array(SIZE[::-1]) - 1).all(axis=1)
            u, v = np.rint(uv[seen]).astype(int).T
            found, (_, left, up), near = cls[v, u], xyz[seen].T, z[seen] < 30
            ground = near & (np.abs(up + 1.73) < 0.12) & (np.abs(left) < 2)  # the scanner stands 1.73 m above it
            standing = near & (up > -0.9) & (up < 0.5)
            on_ground.append(np.isin(found[ground], GROUND).mean())
            on_objects.append((~np.isin(found[standing], [*GROUND, classes.SKY, classes.VOID])).mean())
            in_sky.append((found == classes.SKY).mean())
    assert np.mean(on_ground) > 0.85
    assert np.mean(on_objects) > 0.95
    assert np.mean(in_sky) < 0.002
