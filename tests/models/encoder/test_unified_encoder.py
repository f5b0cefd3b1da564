import pytest
import torch

from models.encoder.heads import MAX_DEPTH_M
from models.encoder.unified_encoder import BACKBONES, UnifiedEncoder, ray_slopes
from pipeline.camera import classes

K = torch.tensor([[[50.0, 0.0, 30.0], [0.0, 40.0, 20.0], [0.0, 0.0, 1.0]]], dtype=torch.float64)


@pytest.fixture(scope="module", params=["small", "espnetv2-s1", "dinov2-vits14", "swin-t"])
def model(request: pytest.FixtureRequest) -> UnifiedEncoder:
    torch.manual_seed(0)
    return UnifiedEncoder(request.param).eval()


@pytest.mark.parametrize("size", [(48, 96), (37, 63)])
def test_one_pass_gives_depth_and_logits_of_every_pixel(model: UnifiedEncoder, size: tuple[int, int]) -> None:
    image = torch.randint(0, 256, (2, 3, *size), dtype=torch.uint8)
    calls: list[object] = []
    hook = model.backbone.register_forward_hook(lambda *_: calls.append(None))
    with torch.no_grad():
        depth, logits = model(image, K.expand(2, 3, 3))
    hook.remove()
    assert depth.shape == (2, *size)
    assert logits.shape in {(2, classes.COUNT, *size), (2, classes.COUNT + 1, *size)}
    assert depth.min() > 0
    assert depth.max() <= MAX_DEPTH_M
    assert len(calls) == 1


def test_a_frame_does_not_depend_on_its_batch(model: UnifiedEncoder) -> None:
    images = torch.randint(0, 256, (3, 3, 48, 96), dtype=torch.uint8)
    with torch.no_grad():
        together = model(images, K.expand(3, 3, 3))
        alone = model(images[1:2], K)
    for a, b in zip(together, alone, strict=True):
        torch.testing.assert_close(a[1:2], b, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("name", list(BACKBONES))
def test_each_backbone_can_be_built_on_meta(name: str) -> None:
    with torch.device("meta"):
        assert sum(parameter.numel() for parameter in UnifiedEncoder(name).parameters()) > 1e5


def test_ray_slopes_follow_the_intrinsics() -> None:
    slopes = ray_slopes(K, torch.Size((41, 61)))[0]
    assert slopes[:, 20, 30].tolist() == [0, 0]
    assert slopes[0, 20, 55].item() == pytest.approx(0.5)
    assert slopes[1, 40, 30].item() == pytest.approx(0.5)
