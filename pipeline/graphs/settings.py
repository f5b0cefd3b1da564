"""Section ``graphs``: the input variants of the steering networks."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pipeline.base.errors import closest
from pipeline.base.params import Count, Seed
from pipeline.clouds.columns import SOURCES
from pipeline.clouds.settings import WithColumns


class Variant(WithColumns):
    """One entry of ``graphs``: an input of the networks, computed from ``data/<source>``."""

    source: Literal["clouds/pseudo", "clouds/lidar", "ingest"]
    # Number of points of a frame. Images have none, and no other keys.
    points: Count | None = None
    # Number of nearest neighbours of a point. With 0, points have no edges.
    k: Annotated[int, Field(ge=0, le=32)] = 0
    # Share of the edges between points of different classes that pruning keeps.
    keep_inter_class: Annotated[float, Field(ge=0, le=1)] = 1.0
    # Limits in metres of x (left, right) and z (near, far) in the camera's frame, in the order
    # [left, near, right, far].
    crop_m: Annotated[tuple[float, float, float, float] | None, Field(strict=False)] = None
    seed: Seed = 0

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
