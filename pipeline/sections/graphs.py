"""Section ``graphs``: what the networks see, one entry per variant."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from pipeline.base.params import Count, Fraction, Positive, Section, Seed

Kind = Literal["graph", "pointnet2", "image"]

_OF_POINTS = {"source", "neighbourhood", "points", "crop_m", "accumulate", "seed"}
_KEYS: dict[Kind, tuple[str, set[str], set[str]]] = {  # what it is, the keys that it needs, and those that it knows
    "graph": ("a kNN graph", {"points", "k"}, {*_OF_POINTS, "k", "keep_inter_class"}),
    "pointnet2": ("neighbourhood: pointnet2", {"points"}, {*_OF_POINTS, "centres", "radius_m", "neighbours"}),
    "image": ("images (source: ingest)", set(), {"source"}),
}


class Accumulate(Section):
    """How a frame's cloud is made of several frames': a graph that spans time."""

    motion: Annotated[Literal["visual", "lidar"], Field(description="which brings them together; of motion.kinds")]
    frames: Annotated[int, Field(ge=2, le=64, description="at most so many, the frame itself among them")]


class Variant(Section):
    """One entry of ``graphs``: what a network sees, made of a folder below data/: clouds, or ingest's images."""

    source: Literal["clouds/pseudo", "clouds/lidar", "ingest"]
    neighbourhood: Literal["knn", "pointnet2"] = "knn"
    points: Count | None = None
    k: Annotated[int, Field(ge=1, le=32)] | None = None
    keep_inter_class: Fraction = 1.0
    crop_m: Annotated[
        tuple[float, float, float, float] | None,
        Field(description="[left, near, right, far] in metres of the camera's x and z; points outside are left out"),
    ] = None
    accumulate: Accumulate | None = None
    # Of each level of PointNet++, the reference's sizes (SSG). Its radii, 0.2 and 0.4, are for objects in a unit
    # sphere; a street reaches some 40 m.
    centres: list[Count] = Field(default=[512, 128], min_length=1)
    radius_m: list[Positive] = Field(default=[8.0, 16.0], min_length=1)
    neighbours: list[Count] = Field(default=[32, 64], min_length=1)
    seed: Seed = 0

    @property
    def kind(self) -> Kind:
        """What the variant's frames are."""
        if self.source == "ingest":
            return "image"
        return "pointnet2" if self.neighbourhood == "pointnet2" else "graph"

    @property
    def levels(self) -> list[tuple[int, float, int]]:
        """Centres, radius and neighbours of each level of PointNet++."""
        return list(zip(self.centres, self.radius_m, self.neighbours, strict=True))

    @model_validator(mode="before")
    @classmethod
    def _names_its_source(cls, content: Any) -> Any:
        if isinstance(content, dict) and "cloud" in content:
            sources = {"pseudo": "clouds/pseudo", "lidar": "clouds/lidar", "none": "ingest"}
            cloud = content["cloud"]
            source = sources.get(str(cloud)) or " | ".join(sources.values())
            raise ValueError(f"cloud: {cloud} is the old spelling: write source: {source} instead")
        return content

    @model_validator(mode="after")
    def _has_what_it_needs_and_no_more(self) -> Self:
        what, needed, known = _KEYS[self.kind]
        for key in sorted(key for key in needed if getattr(self, key) is None):
            raise ValueError(f"{what} needs {key}")
        for key in sorted(self.model_fields_set - known):
            raise ValueError(f"{key} means nothing to {what}: leave it out. Keys that do: {', '.join(sorted(known))}")
        if self.accumulate and (self.source, self.accumulate.motion) == ("clouds/pseudo", "lidar"):
            raise ValueError(
                "accumulate.motion = 'lidar' is in metres, which depth is but roughly: with source: clouds/pseudo "
                "take visual, which knows depth's own scale; with clouds/lidar either"
            )
        if len({len(self.centres), len(self.radius_m), len(self.neighbours)}) > 1:
            raise ValueError("centres, radius_m and neighbours must have one number for each level")
        if self.crop_m and not (self.crop_m[0] < self.crop_m[2] and self.crop_m[1] < self.crop_m[3]):
            raise ValueError("crop_m = [left, near, right, far] needs left < right and near < far")
        return self
