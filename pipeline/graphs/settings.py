"""Section ``graphs``: the input variants of the steering networks."""

from typing import Literal, Self

from pydantic import Field, model_validator

from pipeline.base.errors import closest
from pipeline.base.params import Count, Seed
from pipeline.clouds.columns import SOURCES
from pipeline.clouds.settings import WithColumns


class Variant(WithColumns):
    """One entry of ``graphs``: an input of the networks, computed from ``data/<source>``."""

    source: Literal["clouds/pseudo", "clouds/lidar", "ingest"] = Field(
        description="points of images (`clouds/pseudo`) or of scans (`clouds/lidar`). `ingest` is "
        "images, which have no other keys"
    )
    points: Count | None = Field(
        default=None,
        description="points of a frame, drawn at random from the cloud, or fewer if it has fewer. "
        "Required, except for images. The paper's Table 1 has 43,000 to 50,000",
    )
    k: int = Field(
        default=0,
        ge=0,
        le=32,
        description="nearest neighbours of a point. With 0, points have no edges",
    )
    keep_inter_class: float = Field(
        default=1.0,
        ge=0,
        le=1,
        description="share of the edges between points of different classes that pruning keeps. "
        "The paper's network has 0.2, and 1 is no pruning",
    )
    crop_m: tuple[float, float, float, float] | None = Field(
        default=None,
        strict=False,
        description="limits [left, near, right, far] in metres, with x to the right and z ahead. "
        "`null` is the complete cloud",
    )
    seed: Seed = Field(default=0, description="seed of all draws")

    @property
    def kind(self) -> str:
        if self.source == "ingest":
            return "image"
        return "graph"

    @model_validator(mode="after")
    def _keys_fit_kind(self) -> Self:
        if self.kind == "image":
            for key in sorted(self.model_fields_set - {"source"}):
                raise ValueError(f"{key} does not apply to images (source: ingest): remove it")
        elif self.points is None:
            raise ValueError("points is missing: the number of points of a frame")
        else:
            known = SOURCES[self.source.removeprefix("clouds/")]
            for name in self.columns:
                if name not in known:
                    problem = f"{self.source} has no column {name!r}: {closest(name, [*known])}"
                    raise ValueError(problem)
        if self.crop_m:
            left, near, right, far = self.crop_m
            if not (left < right and near < far):
                raise ValueError(
                    "crop_m = [left, near, right, far] needs left < right and near < far"
                )
        return self
