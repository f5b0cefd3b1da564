"""The convolutional head of the NCP paper (Lechner et al. 2020): an image in, a few numbers out."""

import torch
from torch import Tensor, nn

from models.steering.core.batch import ImageBatch, Kind

INPUT: Kind = "image"
CONVOLUTIONS = [(24, 5, 2), (36, 5, 2), (48, 3, 2), (64, 3, 1), (8, 3, 1)]  # maps, side of the kernel, stride


class SteeringCNN(nn.Module):
    """Standardised image → five convolutions → each of the 8 maps → a dense layer of its own.

    Args:
        features: numbers per frame that go to the recurrent network; the NCP paper has 32, 4 of each map.
        image_size: (H,W) pixels.
    Raises:
        ValueError: `features` is no multiple of the number of maps.
    """

    def __init__(self, features: int, image_size: tuple[int, int]) -> None:
        super().__init__()
        maps = CONVOLUTIONS[-1][0]
        if features % maps:
            raise ValueError(
                f"features = {features}: cnn gives each of its {maps} maps as many: use a multiple of {maps}"
            )
        layers: list[nn.Module] = []
        channels, (height, width) = 3, image_size
        for after, side, stride in CONVOLUTIONS:
            # "Same": a stride of 1 keeps the size, a stride of 2 halves it, rounded up.
            layers += [nn.Conv2d(channels, after, side, stride, padding=side // 2), nn.ReLU()]
            channels, height, width = after, -(-height // stride), -(-width // stride)
        # Weights in the order in which images lie in memory: a seventh faster on a CPU.
        self.convolutions = nn.Sequential(*layers).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.weight = nn.Parameter(torch.empty(maps, height * width, features // maps))
        self.bias = nn.Parameter(torch.zeros(maps, features // maps))
        nn.init.uniform_(self.weight, -((height * width) ** -0.5), (height * width) ** -0.5)  # as nn.Linear

    def forward(self, batch: ImageBatch) -> Tensor:
        """Return [B, features]; other images in the batch do not change an image's numbers."""
        maps = self.convolutions(standardise(batch.image, self.bias.dtype)).flatten(2)  # [B,8,hw]
        return (torch.einsum("bmp,mpf->bmf", maps, self.weight) + self.bias).relu().flatten(1)


def standardise(image: Tensor, dtype: torch.dtype) -> Tensor:
    """Give each image mean 0 and deviation 1 over all its pixels and channels: uint8 [B,H,W,3] → [B,3,H,W]."""
    pixels = image.to(dtype).permute(0, 3, 1, 2)
    deviation, mean = torch.std_mean(pixels, dim=(1, 2, 3), keepdim=True, correction=0)
    return (pixels - mean) / deviation.clamp_min(pixels[0].numel() ** -0.5)  # an image of one colour becomes 0


network = SteeringCNN
