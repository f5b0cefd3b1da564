"""RT-MonoDepth-S without classes: depth of real streets from published weights, nothing to fit.

For visual odometry, which finds traffic by its own motion. Monodepth2's terms: non-commercial use only.
"""

from collections.abc import Sequence

from torch import Tensor

from models.encoder.backbones import Part, Parts
from models.encoder.backbones.rtmonodepth_s import Depth, Encoder
from pipeline.camera import classes


def street() -> Parts:
    """Return the parts; all pixels are void."""
    return Parts(Encoder(), Depth(), Void())


class Void(Part):
    """A class head without parameters."""

    def forward(self, maps: Sequence[Tensor], rays: Tensor) -> Tensor:
        """Return logits [B,20,H,W], 1 for void and 0 for all classes."""
        logits = rays.new_zeros(len(rays), classes.COUNT + 1, *rays.shape[-2:])
        logits[:, -1] = 1
        return logits
