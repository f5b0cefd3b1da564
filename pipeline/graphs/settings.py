"""Section ``graphs``: the input variants of the steering networks."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pipeline.base.params import Count, Positive, Section, Seed

_POINT_KEYS = {"source", "neighbourhood", "points", "sampling", "crop_m", "accumulate", "seed"}
# kind → name in messages, required keys, allowed keys
_KEYS: dict[str, tuple[str, set[str], set[str]]] = {
    "graph": ("a kNN graph", {"points", "k"}, {*_POINT_KEYS, "k", "keep_inter_class"}),
    "pointnet2": (
        "neighbourhood: pointnet2",
        {"points"},
        {*_POINT_KEYS, "centres", "radius_m", "neighbours"},
    ),
    "image": ("images (source: ingest)", set(), {"source"}),
}


class Variant(Section):
    """One entry of ``graphs``: an input of the networks, computed from ``data/<source>``."""

    source: Literal["clouds/pseudo", "clouds/lidar", "ingest"]
    neighbourhood: Literal["knn", "pointnet2"] = "knn"
    points: Count | None = None
    # range: equal numbers of points from intervals of range
    sampling: Literal["uniform", "range"] = "uniform"
    # nearest neighbours; 0: points without edges
    k: Annotated[int, Field(ge=0, le=32)] | None = None
    keep_inter_class: Annotated[float, Field(ge=0, le=1)] = 1.0
    # [left, near, right, far]: limits of the camera's x and z
    crop_m: Annotated[tuple[float, float, float, float] | None, Field(strict=False)] = None
    # frames in a cloud at most, the current one included
    accumulate: Annotated[int, Field(ge=2, le=64)] | None = None
    # One value per level of PointNet++; the defaults are the published sizes (SSG). The published
    # radii, 0.2 and 0.4, are for objects in a unit sphere; a street extends about 40 m.
    centres: list[Count] = Field(default=[512, 128], min_length=1)
    radius_m: list[Positive] = Field(default=[8.0, 16.0], min_length=1)
    neighbours: list[Count] = Field(default=[32, 64], min_length=1)
    seed: Seed = 0

    @property
    def kind(self) -> str:
        return (
            "image"
            if self.source == "ingest"
            else "graph"
            if self.neighbourhood == "knn"
            else "pointnet2"
        )

    @property
    def levels(self) -> list[tuple[int, float, int]]:
        """Return centres, radius and neighbours of each level of PointNet++."""
        return list(zip(self.centres, self.radius_m, self.neighbours, strict=True))

    @model_validator(mode="after")
    def _keys_fit_kind(self) -> Self:
        what, required, allowed = _KEYS[self.kind]
        if missing := [key for key in sorted(required) if getattr(self, key) is None]:
            raise ValueError(f"{what} needs {missing[0]}")
        for key in sorted(self.model_fields_set - allowed):
            raise ValueError(f"{key} does not apply to {what}: remove it")
        if len({len(self.centres), len(self.radius_m), len(self.neighbours)}) > 1:
            raise ValueError("centres, radius_m and neighbours need one number per level each")
        if self.crop_m and not (
            self.crop_m[0] < self.crop_m[2] and self.crop_m[1] < self.crop_m[3]
        ):
            raise ValueError("crop_m = [left, near, right, far] needs left < right and near < far")
        return self
