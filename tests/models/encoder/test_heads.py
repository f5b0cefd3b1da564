import pytest
import torch
import torch.nn.functional as F

from models.encoder.heads import CellClasses, Pointwise, full


def test_pointwise_is_a_1x1_convolution() -> None:
    layer, x = Pointwise(5, 3), torch.randn(2, 5, 4, 6).to(memory_format=torch.channels_last)
    torch.testing.assert_close(layer(x), F.conv2d(x, layer.weight, layer.bias))
    assert layer(x).is_contiguous(memory_format=torch.channels_last)  # the next layer copies nothing


@pytest.mark.parametrize("size", [(8, 12), (7, 11)])
def test_classes_of_cells_are_a_sub_pixel_convolution(size: tuple[int, int]) -> None:
    """The same logits and gradients as by torch's convolution and pixel shuffle."""
    torch.manual_seed(0)
    head, features, rays = CellClasses(6, 2), torch.randn(2, 6, 4, 6, requires_grad=True), torch.zeros(2, 2, *size)
    weights = torch.randn(2, 19, *size)
    answers = [head(features, rays), full(head.layer(features), 2, rays)]
    torch.testing.assert_close(*answers)
    parts = [features, *head.parameters()]
    torch.testing.assert_close(*([*torch.autograd.grad((answer * weights).sum(), parts)] for answer in answers))
