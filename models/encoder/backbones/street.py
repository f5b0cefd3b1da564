"""Depth by RT-MonoDepth-S and classes by ESPNetv2: an encoder of real streets with published weights alone.

Two networks run side by side, since neither has both heads. Depth is under Monodepth2's terms: non-commercial use only.
"""

from collections.abc import Sequence

from torch import Tensor

from models.encoder.backbones import IMAGENET_MEAN, IMAGENET_STD, Part, Parts, rtmonodepth_s
from models.encoder.backbones.espnetv2 import DecodedClasses, ESPNetv2


def street() -> Parts:
    """Return the parts; the class head is a complete network."""
    return Parts(Encoder(), Depth(), Classes())


class Encoder(rtmonodepth_s.Encoder):
    """RT-MonoDepth-S's maps, and the image for the class head."""

    def forward(self, image: Tensor, rays: Tensor) -> list[Tensor]:
        """Return the image [B,3,H,W] after the maps."""
        return [*super().forward(image, rays), image]


class Depth(rtmonodepth_s.Depth):
    """RT-MonoDepth-S's depth."""

    def forward(self, maps: Sequence[Tensor], rays: Tensor) -> Tensor:
        """Return depth [B,H,W] in metres."""
        return super().forward(maps[:-1], rays)


class Classes(ESPNetv2, Part):
    """ESPNetv2 of scale 1 with its own normalisation of the image."""

    def __init__(self) -> None:
        super().__init__(1.0)
        self.decoded = DecodedClasses()

    def forward(self, maps: Sequence[Tensor], rays: Tensor) -> Tensor:  # type: ignore[override]
        """Return logits [B,20,H,W], void last."""
        image = maps[-1]
        rgb = image * image.new_tensor(Encoder.std)[:, None, None] + image.new_tensor(Encoder.mean)[:, None, None]
        mean, std = image.new_tensor(IMAGENET_MEAN), image.new_tensor(IMAGENET_STD)
        logits: Tensor = self.decoded(super().forward((rgb - mean[:, None, None]) / std[:, None, None], rays), rays)
        return logits
