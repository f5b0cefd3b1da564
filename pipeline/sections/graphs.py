"""Section ``graphs``: what the networks eat, one entry per variant."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pipeline.base.params import Count, Fraction, Positive, Section, Seed

Kind = Literal["graph", "pointnet2", "image"]


class Variant(Section):
    """One entry of ``graphs``: what a network eats. Without a cloud it is the images."""

    cloud: Literal["pseudo", "lidar", "none"]
    neighbourhood: Literal["knn", "pointnet2"] = "knn"
    points: Count = 0  # 0, which nobody can give: not given
    k: Annotated[int, Field(ge=1, le=32)] = 0
    keep_inter_class: Fraction = 1.0
    crop_m: Annotated[
        tuple[float, float, float, float] | None,
        Field(description="[left, near, right, far] in metres of the camera's x and z; points outside are left out"),
    ] = None
    # Of each level of PointNet++, the reference's sizes (SSG). Its radii, 0.2 and 0.4, are for objects in a unit
    # sphere; a street is seen to some 40 m.
    centres: list[Count] = Field(default=[512, 128], min_length=1)
    radius_m: list[Positive] = Field(default=[8.0, 16.0], min_length=1)
    neighbours: list[Count] = Field(default=[32, 64], min_length=1)
    seed: Seed = 0

    @property
    def kind(self) -> Kind:
        """What the variant's frames are."""
        if self.cloud == "none":
            return "image"
        return "pointnet2" if self.neighbourhood == "pointnet2" else "graph"

    @property
    def levels(self) -> list[tuple[int, float, int]]:
        """Centres, radius and neighbours of each level of PointNet++."""
        return list(zip(self.centres, self.radius_m, self.neighbours, strict=True))

    @model_validator(mode="after")
    def _says_what_it_needs_and_no_more(self) -> Self:
        sizes = {"centres", "radius_m", "neighbours"}
        anyhow = {"cloud", "neighbourhood", "crop_m", "seed"}
        what, needed, possible = {
            "graph": ("a kNN graph", {"points", "k"}, anyhow | {"keep_inter_class"}),
            "pointnet2": ("neighbourhood: pointnet2", {"points"}, anyhow | sizes),
            "image": ("a variant without a cloud", set(), {"cloud"}),
        }[self.kind]
        for key in sorted(needed - self.model_fields_set):
            raise ValueError(f"{what} needs {key}")
        for key in sorted(self.model_fields_set - needed - possible):
            raise ValueError(f"{key} says nothing to {what}: leave it out")
        if len({len(self.centres), len(self.radius_m), len(self.neighbours)}) > 1:
            raise ValueError("centres, radius_m and neighbours must have one number for each level")
        if self.crop_m and not (self.crop_m[0] < self.crop_m[2] and self.crop_m[1] < self.crop_m[3]):
            raise ValueError("crop_m = [left, near, right, far] needs left < right and near < far")
        return self
