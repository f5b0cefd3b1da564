import pytest
import torch
from torch.nn import functional

from models.steering.core.batch import ImageBatch
from models.steering.spatial.cnn import SteeringCNN

TOLERANCE = {"rtol": 0, "atol": 1e-9}


@pytest.fixture
def network():
    torch.manual_seed(0)
    return SteeringCNN(32, image_size=(33, 50)).double()


def images(count: int = 3, size: tuple[int, int] = (33, 50)) -> ImageBatch:
    generator = torch.Generator().manual_seed(1)
    return ImageBatch(torch.randint(0, 256, (count, *size, 3), generator=generator, dtype=torch.uint8))


def test_the_layers_are_those_of_the_ncp_paper(network):
    """Reference: one image, layer and map at a time, with explicit padding."""
    batch = images()
    convolutions = [layer for layer in network.convolutions if isinstance(layer, torch.nn.Conv2d)]
    assert [(c.out_channels, c.kernel_size[0], c.stride[0]) for c in convolutions] == [
        (24, 5, 2), (36, 5, 2), (48, 3, 2), (64, 3, 1), (8, 3, 1)
    ]  # fmt: skip
    expected = []
    for image in batch.image.double():
        x = ((image - image.mean()) / image.std(correction=0)).movedim(2, 0)[None]
        for layer in convolutions:
            margin = layer.kernel_size[0] // 2
            x = functional.conv2d(functional.pad(x, [margin] * 4), layer.weight, layer.bias, layer.stride).relu()
        assert x.shape == (1, 8, 5, 7)  # 33 × 50 halved three times, rounded up
        dense = [x[0, number].flatten() @ network.weight[number] + network.bias[number] for number in range(8)]
        expected.append(torch.cat(dense).relu())
    torch.testing.assert_close(network(batch), torch.stack(expected), **TOLERANCE)


def test_batch_equals_single_images(network):
    batch = images()
    singles = torch.cat([network(ImageBatch(image[None])) for image in batch.image])
    torch.testing.assert_close(network(batch), singles, **TOLERANCE)
