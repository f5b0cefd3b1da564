"""The convolutional head of the NCP paper (Lechner et al. 2020)."""

import math

import torch
from torch import Tensor, nn

from models.steering.core.batch import ImageBatch
from models.steering.core.options import NetworkOptions, Sizes
from pipeline.base.errors import InputError

# Number of maps, kernel size and stride of each convolution.
CONVOLUTIONS = [(24, 5, 2), (36, 5, 2), (48, 3, 2), (64, 3, 1), (8, 3, 1)]


class SteeringCNN(nn.Module):
    """Standardised image, five convolutions, and a dense layer for each of the 8 maps.

    The NCP paper has 32 features. Raises InputError if `features` is not a multiple of 8.
    """

    def __init__(self, features: int, image_size: tuple[int, int]) -> None:
        super().__init__()
        maps = CONVOLUTIONS[-1][0]
        if features % maps:
            raise InputError(f"features = {features}, expected a multiple of cnn's {maps} maps")
        layers: list[nn.Module] = []
        inputs = 3
        height, width = image_size
        for outputs, side, stride in CONVOLUTIONS:
            # Padding "same": a stride of 1 keeps the size, a stride of 2 halves it, rounded up.
            layers += [nn.Conv2d(inputs, outputs, side, stride, padding=side // 2), nn.ReLU()]
            inputs = outputs
            height = math.ceil(height / stride)
            width = math.ceil(width / stride)
        # Weights in the memory order of the images make this 14 % faster on a CPU.
        self.convolutions = nn.Sequential(*layers).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.weight = nn.Parameter(torch.empty(maps, height * width, features // maps))
        self.bias = nn.Parameter(torch.zeros(maps, features // maps))
        # Initialise as nn.Linear does.
        bound = (height * width) ** -0.5
        nn.init.uniform_(self.weight, -bound, bound)

    def forward(self, batch: ImageBatch) -> Tensor:
        pixels = standardise_images(batch.image, self.bias.dtype)
        maps = self.convolutions(pixels).flatten(2)  # [B,8,hw]
        features = torch.einsum("bmp,mpf->bmf", maps, self.weight) + self.bias
        return features.flatten(1)


def standardise_images(image: Tensor, dtype: torch.dtype) -> Tensor:
    """Scale each image to mean 0 and deviation 1 over its pixels and channels.

    The shapes are uint8 [B,H,W,3] → [B,3,H,W]. A uniform image becomes 0.
    """
    pixels = image.to(dtype).permute(0, 3, 1, 2)
    deviation, mean = torch.std_mean(pixels, dim=(1, 2, 3), keepdim=True, correction=0)
    return (pixels - mean) / deviation.clamp_min(pixels[0].numel() ** -0.5)


class Options(NetworkOptions):
    kind = "image"

    def build(self, sizes: Sizes) -> nn.Module:
        return SteeringCNN(sizes.features, sizes.image_size)
