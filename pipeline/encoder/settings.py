"""Section ``encoder``: the network for depth and classes, its weights, and how it is fitted."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pipeline.base.params import Count, Positive, Section, Seed

FilePath = Annotated[Path, Field(strict=False)]
# Name of a network on Hugging Face's hub, or its folder.
Hub = Annotated[str, Field(min_length=1)]
# Backbone → keys that must be set for it, unless `weights` is set.
NEEDED = {
    "pair": ("depth", "classes", "focal_by_width"),
    "hugging_face": ("model",),
}
# Backbones that can be fitted.
FITTED = {"small", "hugging_face"}


class Encoder(Section):
    backbone: Literal["small", "street", "pair", "hugging_face", "precomputed"] = Field(
        description="network for depth and classes. For `precomputed`, files take its place"
    )
    weights: FilePath | None = Field(
        default=None,
        description="an `encoder.pt` of this project, or the folder of `precomputed`. `null` is "
        "random weights, or the published ones of the backbone",
    )
    weights_sha256: str | None = Field(
        default=None,
        description="SHA-256 of the weights. `make NAME` writes it, so that DVC notices another "
        "file",
    )
    depth: Hub | None = Field(
        default=None,
        description="of `pair`: network for depth, a name on Hugging Face's hub or a folder",
    )
    classes: Hub | None = Field(
        default=None,
        description="of `pair`: network for classes, a name on Hugging Face's hub or a folder",
    )
    model: Hub | None = Field(
        default=None,
        description="of `hugging_face`: backbone, a name on Hugging Face's hub or a folder",
    )
    focal_by_width: Positive | None = Field(
        default=None,
        description="of `pair`: focal length / image width of the depth network's training camera",
    )
    epochs: int = Field(
        ge=0,
        description="epochs of the fit, of `small` and `hugging_face` only. With 0 the weights "
        "stay as they are",
    )
    frames: Count = Field(description="frames of the fit, spread evenly over the training drives")
    batch: Count = Field(description="frames in a step of the fit")
    learning_rate: Positive = Field(
        description="largest learning rate of the fit. It rises at first, then falls"
    )
    seed: Seed = Field(description="seed of new weights, and of the order of the frames")

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
