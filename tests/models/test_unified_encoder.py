import pytest
import torch

from models.unified_encoder import BACKBONES, CLASSES, MAX_DEPTH_M, MIN_DEPTH_M, UnifiedEncoder, ray_slopes

K = torch.tensor([[[50.0, 0.0, 30.0], [0.0, 40.0, 20.0], [0.0, 0.0, 1.0]]], dtype=torch.float64)


@pytest.fixture(params=list(BACKBONES))
def model(request: pytest.FixtureRequest) -> UnifiedEncoder:
    torch.manual_seed(0)
    return UnifiedEncoder(request.param).eval()


@pytest.mark.parametrize("size", [(48, 96), (37, 63)])
def test_one_call_gives_depth_and_logits_of_every_pixel(model: UnifiedEncoder, size: tuple[int, int]) -> None:
    image = torch.randint(0, 256, (2, 3, *size), dtype=torch.uint8)
    calls: list[object] = []
    model.backbone.register_forward_hook(lambda *_: calls.append(None))
    with torch.no_grad():
        depth, logits = model(image, K.expand(2, 3, 3))
    assert depth.shape == (2, *size)
    assert logits.shape == (2, CLASSES, *size)
    assert depth.min() >= MIN_DEPTH_M
    assert depth.max() <= MAX_DEPTH_M
    assert len(calls) == 1


def test_backbone_keeps_its_promise_on_channels_and_stride(model: UnifiedEncoder) -> None:
    features = model.backbone(torch.rand(1, 3, 37, 63), torch.rand(1, 2, 37, 63))
    stride = model.backbone.stride
    assert features.shape == (1, model.backbone.channels, -(-37 // stride), -(-63 // stride))


def test_both_heads_teach_the_shared_backbone(model: UnifiedEncoder) -> None:
    image = torch.randint(0, 256, (2, 3, 48, 96), dtype=torch.uint8)
    for output in (0, 1):
        model.zero_grad()
        model(image, K.expand(2, 3, 3))[output].sum().backward()
        assert all(parameter.grad is not None for parameter in model.backbone.parameters())


def test_bytes_and_fractions_are_the_same_image(model: UnifiedEncoder) -> None:
    image = torch.randint(0, 256, (1, 3, 48, 96), dtype=torch.uint8)
    with torch.no_grad():
        for a, b in zip(model(image, K), model(image.float() / 255, K), strict=True):
            torch.testing.assert_close(a, b)


def test_unknown_backbone_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"no backbone 'large': known: .*small"):
        UnifiedEncoder("large")


def test_ray_slopes_follow_the_intrinsics() -> None:
    slopes = ray_slopes(K, torch.Size((41, 61)))[0]
    assert slopes[:, 20, 30].tolist() == [0, 0]
    assert slopes[0, 20, 55].item() == pytest.approx(0.5)
    assert slopes[1, 40, 30].item() == pytest.approx(0.5)
