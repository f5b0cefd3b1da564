"""Section ``encoder``: the network of depth and classes, its weights, and how it is fitted."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pipeline.base.params import Count, Positive, Rate, Section, Seed

FilePath = Annotated[Path, Field(strict=False)]
Hub = Annotated[str, Field(min_length=1, description="a name on the hub, or a folder")]
# Backbone → keys that it needs unless it has weights.
NEEDED = {
    "pair": ("depth", "classes", "focal_by_width"),
    "hugging_face": ("model",),
}
# Backbones that can be fitted.
FITTED = {"small", "hugging_face"}


class Encoder(Section):
    backbone: Literal["small", "street", "pair", "hugging_face", "precomputed"]
    weights: FilePath | None = None
    # Hash of the weights. make NAME writes it, so that DVC notices another file.
    weights_sha256: str | None = None
    depth: Hub | None = None
    classes: Hub | None = None
    model: Hub | None = None
    depth_unit: Literal["metric"] | None = None
    focal_by_width: Positive | None = None
    epochs: Annotated[int, Field(ge=0)]
    frames: Count
    batch: Count
    learning_rate: Rate
    seed: Seed

    @model_validator(mode="after")
    def _complete(self) -> Self:
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
