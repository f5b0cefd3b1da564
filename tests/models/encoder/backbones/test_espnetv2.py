import pytest
import torch
import torch.nn.functional as F

from models.encoder.backbones.espnetv2 import espnetv2


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
