"""Section ``graphs``: the input variants of the steering networks."""

from typing import Annotated, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from pipeline.base.params import Count, Positive, Section, Seed


class _Kind(NamedTuple):
    """A kind of frames, and the keys of the variants that make such frames."""

    name: str  # how messages call it
    required: set[str]
    optional: set[str]


_POINT_KEYS = {"source", "neighbourhood", "sampling", "crop_m", "accumulate", "seed"}
# Name of a kind of frames → its keys.
KINDS = {
    "graph": _Kind("a kNN graph", {"points", "k"}, _POINT_KEYS | {"keep_inter_class"}),
    "pointnet2": _Kind(
        "neighbourhood: pointnet2", {"points"}, _POINT_KEYS | {"centres", "radius_m", "neighbours"}
    ),
    "image": _Kind("images (source: ingest)", set(), {"source"}),
}


class Variant(Section):
    """One entry of ``graphs``: an input of the networks, computed from ``data/<source>``."""

    source: Literal["clouds/pseudo", "clouds/lidar", "ingest"]
    neighbourhood: Literal["knn", "pointnet2"] = "knn"
    points: Count | None = None
    # How points are drawn. With range, equal numbers are drawn from intervals of range.
    sampling: Literal["uniform", "range"] = "uniform"
    # Number of nearest neighbours of a point. With 0, points have no edges.
    k: Annotated[int, Field(ge=0, le=32)] | None = None
    # Share of the edges between points of different classes that pruning keeps.
    keep_inter_class: Annotated[float, Field(ge=0, le=1)] = 1.0
    # Limits in metres of x (left, right) and z (near, far) in the camera's frame, in the order
    # [left, near, right, far].
    crop_m: Annotated[tuple[float, float, float, float] | None, Field(strict=False)] = None
    # Largest number of frames whose clouds are combined, the current frame included.
    accumulate: Annotated[int, Field(ge=2, le=64)] | None = None
    # Number of centres in each level of PointNet++. The defaults of this setting and of neighbours
    # are the published sizes (SSG).
    centres: list[Count] = Field(default=[512, 128], min_length=1)
    # Radius in metres around a centre, for each level. The published radii, 0.2 and 0.4, are for
    # objects in a unit sphere, but a street extends about 40 m.
    radius_m: list[Positive] = Field(default=[8.0, 16.0], min_length=1)
    # Number of neighbours of a centre, for each level.
    neighbours: list[Count] = Field(default=[32, 64], min_length=1)
    seed: Seed = 0

    @property
    def kind(self) -> str:
        if self.source == "ingest":
            return "image"
        if self.neighbourhood == "knn":
            return "graph"
        return "pointnet2"

    @property
    def levels(self) -> list[tuple[int, float, int]]:
        """Return centres, radius and neighbours of each level of PointNet++."""
        return list(zip(self.centres, self.radius_m, self.neighbours, strict=True))

    @model_validator(mode="after")
    def _keys_fit_kind(self) -> Self:
        kind = KINDS[self.kind]
        for key in sorted(kind.required):
            if getattr(self, key) is None:
                raise ValueError(f"{kind.name} needs {key}")
        for key in sorted(self.model_fields_set - kind.required - kind.optional):
            raise ValueError(f"{key} does not apply to {kind.name}: remove it")
        if len({len(self.centres), len(self.radius_m), len(self.neighbours)}) > 1:
            raise ValueError("centres, radius_m and neighbours need one number per level each")
        if self.crop_m:
            left, near, right, far = self.crop_m
            if not (left < right and near < far):
                raise ValueError(
                    "crop_m = [left, near, right, far] needs left < right and near < far"
                )
        return self
