"""Section ``graphs``: the input of the networks, one entry per variant."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pipeline.base.params import Count, Fraction, Positive, Section, Seed

Kind = Literal["graph", "pointnet2", "image"]

_POINT_KEYS = {"source", "neighbourhood", "points", "crop_m", "accumulate", "seed"}
_KEYS: dict[Kind, tuple[str, set[str], set[str]]] = {  # kind → description, required keys, allowed keys
    "graph": ("a kNN graph", {"points", "k"}, {*_POINT_KEYS, "k", "keep_inter_class"}),
    "pointnet2": ("neighbourhood: pointnet2", {"points"}, {*_POINT_KEYS, "centres", "radius_m", "neighbours"}),
    "image": ("images (source: ingest)", set(), {"source"}),
}


class Accumulate(Section):
    """Combine the clouds of several frames."""

    motion: Annotated[Literal["visual", "lidar"], Field(description="motion that aligns them; one of motion.kinds")]
    frames: Annotated[int, Field(ge=2, le=64, description="largest number of frames, the current one included")]


class Variant(Section):
    """One entry of ``graphs``: the networks' input, made from a folder of data/ with clouds or ingest's images."""

    source: Literal["clouds/pseudo", "clouds/lidar", "ingest"]
    neighbourhood: Literal["knn", "pointnet2"] = "knn"
    points: Count | None = None
    k: Annotated[int, Field(ge=1, le=32)] | None = None
    keep_inter_class: Fraction = 1.0
    crop_m: Annotated[
        tuple[float, float, float, float] | None,
        Field(
            description="[left, near, right, far] in metres: limits of the camera's x and z"
        ),
    ] = None
    accumulate: Accumulate | None = None
    # Of each level of PointNet++, the reference's sizes (SSG). Its radii, 0.2 and 0.4, are for objects in a unit
    # sphere; a street extends to about 40 m.
    centres: list[Count] = Field(default=[512, 128], min_length=1)
    radius_m: list[Positive] = Field(default=[8.0, 16.0], min_length=1)
    neighbours: list[Count] = Field(default=[32, 64], min_length=1)
    seed: Seed = 0

    @property
    def kind(self) -> Kind:
        """The kind of the variant's frames."""
        if self.source == "ingest":
            return "image"
        return "pointnet2" if self.neighbourhood == "pointnet2" else "graph"

    @property
    def levels(self) -> list[tuple[int, float, int]]:
        """Centres, radius and neighbours of each level of PointNet++."""
        return list(zip(self.centres, self.radius_m, self.neighbours, strict=True))

    @model_validator(mode="after")
    def _check_keys(self) -> Self:
        description, required, allowed = _KEYS[self.kind]
        for key in sorted(key for key in required if getattr(self, key) is None):
            raise ValueError(f"{key} is missing for {description}")
        for key in sorted(self.model_fields_set - allowed):
            raise ValueError(f"{key} is not an option of {description} (options: {', '.join(sorted(allowed))})")
        if self.accumulate and (self.source, self.accumulate.motion) == ("clouds/pseudo", "lidar"):
            raise ValueError(
                "accumulate.motion = 'lidar' is in metres, the depth of clouds/pseudo only approximately: choose "
                "motion: visual, which has the scale of the depth, or source: clouds/lidar"
            )
        if len({len(self.centres), len(self.radius_m), len(self.neighbours)}) > 1:
            raise ValueError("centres, radius_m and neighbours must have one number for each level")
        if self.crop_m and not (self.crop_m[0] < self.crop_m[2] and self.crop_m[1] < self.crop_m[3]):
            raise ValueError("crop_m = [left, near, right, far] needs left < right and near < far")
        return self
