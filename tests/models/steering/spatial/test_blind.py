import torch

from models.steering.spatial.blind import Blind


def test_output_is_zero(make_batch):
    blind = Blind(5)
    assert torch.equal(blind(make_batch([13, 0])), torch.zeros(2, 5))
    assert torch.equal(blind(make_batch([7, 30])), torch.zeros(2, 5))
    assert not list(blind.parameters())
