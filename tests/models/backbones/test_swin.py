import torch
from transformers import SwinConfig, SwinForImageClassification

from models.backbones.swin import CHANNELS, swin


def test_a_published_classifier_fills_the_backbone_and_gives_the_same_features() -> None:
    torch.manual_seed(0)
    published = SwinForImageClassification(SwinConfig()).eval()  # the defaults are Swin-T
    backbone = swin().backbone.eval()
    backbone.load_state_dict(backbone.own_names(published.state_dict()), strict=True)
    image = torch.rand(1, 3, 448, 448)  # on smaller maps a classifier shifts no windows
    with torch.no_grad():
        maps = backbone(image, torch.zeros(1, 2, 448, 448))
        last = published.swin(image).last_hidden_state
    assert [tuple(one.shape[1:]) for one in maps] == [(c, 112 >> i, 112 >> i) for i, c in enumerate(CHANNELS)]
    norm = published.swin.layernorm
    torch.testing.assert_close(norm(maps[-1].flatten(2).mT), last, rtol=1e-5, atol=1e-5)
