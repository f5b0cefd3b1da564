"""Section ``encoder``: the network for depth and classes, its weights, and how it is fitted."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pipeline.base.params import Count, Positive, Rate, Section, Seed

FilePath = Annotated[Path, Field(strict=False)]
Hub = Annotated[str, Field(min_length=1, description="a name on the hub, or a folder")]
# Backbone → keys that must be set for it, unless `weights` is set.
NEEDED = {
    "pair": ("depth", "classes", "focal_by_width"),
    "hugging_face": ("model",),
}
# Backbones that can be fitted.
FITTED = {"small", "hugging_face"}


class Encoder(Section):
    # Kind of network, see docs/models.md. For `precomputed`, files take the place of a network.
    backbone: Literal["small", "street", "pair", "hugging_face", "precomputed"]
    # An encoder.pt, or for `precomputed` a folder of PNG files.
    weights: FilePath | None = None
    # SHA-256 of the weights. make NAME writes it, so that DVC notices another file.
    weights_sha256: str | None = None
    # Network for depth of the backbone `pair`.
    depth: Hub | None = None
    # Network for classes of the backbone `pair`.
    classes: Hub | None = None
    # Network of the backbone `hugging_face`.
    model: Hub | None = None
    # Focal length of the training images of `depth`, divided by their width.
    focal_by_width: Positive | None = None
    # Number of epochs of the fit; 0: no fit.
    epochs: Annotated[int, Field(ge=0)]
    # Number of training frames, spread evenly over the training drives.
    frames: Count
    # Number of frames in a step of the fit.
    batch: Count
    learning_rate: Rate
    seed: Seed

    @model_validator(mode="after")
    def _check_complete(self) -> Self:
        kind = f"backbone: {self.backbone}"
        if self.backbone == "precomputed" and not self.weights:
            raise ValueError(f"{kind} needs a folder of PNG files in weights, see docs/models.md")
        missing = [key for key in NEEDED.get(self.backbone, ()) if getattr(self, key) is None]
        if missing and not self.weights:
            raise ValueError(f"{kind} needs {' and '.join(missing)}, or an encoder.pt in weights")
        if self.epochs and self.backbone not in FITTED:
            raise ValueError(f"{kind} is not fitted: set epochs: 0")
        if not self.epochs and not self.weights and self.backbone in FITTED:
            raise ValueError(
                f"{kind} with epochs: 0 needs a fitted encoder.pt in weights, or set epochs"
            )
        return self
