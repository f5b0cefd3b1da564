import torch

from models.encoder.backbones.small import Small


def test_backbone_keeps_its_promise_on_channels_and_stride() -> None:
    features = Small()(torch.rand(1, 3, 37, 63), torch.rand(1, 2, 37, 63))
    assert features.shape == (1, Small.channels, -(-37 // Small.stride), -(-63 // Small.stride))
