"""Section ``models``: the networks, one entry each."""

from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from models.steering.core import options, steering_net
from pipeline.base.errors import InputError, closest
from pipeline.base.params import Rate, Section, parse

FRAMES = {
    "graph": "kNN graphs",
    "pointnet2": "points with neighbourhood: pointnet2",
    "image": "images",
}


class Entry(Section):
    """One entry of ``models``: a spatial and a temporal network on a graph variant.

    Further keys are fields of class Options of the two networks. A validated entry has them all.
    """

    model_config = ConfigDict(extra="allow")
    # No defaults: dvc.yaml takes these three from params.yaml.
    input: str
    spatial: str
    temporal: str
    window: Annotated[int, Field(ge=1, le=256)] = 8  # frames per prediction
    equivariant: bool = False  # the output is odd under left-right mirroring
    learning_rate: Rate | None = None  # overrides train.learning_rate
    # per rad; weight exp(alpha |steering|) of eq. 9
    alpha: Annotated[float, Field(ge=0, le=100)] = 0.0
    features: Annotated[int, Field(ge=1, le=1024)] = 32  # per frame, between the two networks
    # path: mean curvature of the path ahead in the ranges of labels.ahead_m
    predict: Literal["angle", "path"] = "angle"
    # frames between the last input frame and the predicted angle
    horizon: Annotated[int, Field(ge=0, le=10_000)] = 0
    motion: Literal["none", "visual"] = "none"  # visual: measured motion is an input, too
    # What the output is added to: the last frame's measured angle, for a path its regression on it,
    # or 0.
    base: Literal["motion", "none"] = "motion"
    # another: a control with the scene of another drive of the split
    scene: Literal["same", "another"] = "same"

    @model_validator(mode="after")
    def _check(self) -> Self:
        for key in ("horizon", "alpha") if self.predict == "path" else ():
            if value := getattr(self, key):
                raise ValueError(f"predict: path has no {key} (got {value}): remove {key}")
        return self

    @model_validator(mode="before")
    @classmethod
    def _add_options(cls, value: Any) -> Any:
        """Add the defaults of the networks' options. Raises ValueError for a wrong key or value."""
        if not isinstance(value, dict) or not {"spatial", "temporal"} <= value.keys():
            return value
        networks = (
            options.load_options("spatial", value["spatial"]),
            options.load_options("temporal", value["temporal"]),
        )
        fields = {
            name: field for network in networks for name, field in network.model_fields.items()
        }
        known, where = (
            [*cls.model_fields, *fields],
            f"spatial = {value['spatial']}, temporal = {value['temporal']}",
        )
        for key in value.keys() - known:
            raise ValueError(f"unknown key {key!r} for {where}: {closest(str(key), known)}")
        for name, field in fields.items():
            if field.is_required() and name not in value:
                raise ValueError(f"{name} is missing: {field.description}")
        complete = dict(value)
        for network in networks:
            complete |= parse(
                network, {key: value[key] for key in network.model_fields if key in value}
            ).model_dump()
        return complete

    @property
    def networks(self) -> list[str]:
        """The files of the two networks."""
        return [
            f"models/steering/spatial/{self.spatial}.py",
            f"models/steering/temporal/{self.temporal}.py",
        ]

    def seeded(self, seed: int) -> Self:
        """Return the entry with `seed` for the wiring of an NCP, unless it has one."""
        wiring = (self.model_extra or {}).get("wiring")
        if wiring is None or wiring["seed"] is not None:
            return self
        return self.model_copy(update={"wiring": wiring | {"seed": seed}})

    def build(
        self,
        kind: str,
        levels: int = 0,
        image_size: tuple[int, int] | None = None,
        outputs: int = 1,
    ) -> steering_net.SteeringNet:
        """Build the network with new weights from torch's random state.

        `kind`, `levels` and `image_size` describe the frames of the entry's input, see
        graph_file.Contents; `outputs`: R ranges of a path. Raises InputError if the network reads
        another kind or an option is out of range.
        """
        spatial, temporal = (
            network.model_validate({name: getattr(self, name) for name in network.model_fields})
            for network in (
                options.load_options("spatial", self.spatial),
                options.load_options("temporal", self.temporal),
            )
        )
        if spatial.kind != kind:
            expects = f"spatial = {self.spatial!r} expects {FRAMES[str(spatial.kind)]}"
            raise InputError(f"{expects}, but input: {self.input} holds {FRAMES[kind]}")
        sizes, motion = (
            options.Sizes(self.features, levels, image_size or (0, 0), outputs),
            self.motion != "none",
        )
        return steering_net.SteeringNet(
            spatial, temporal, sizes, equivariant=self.equivariant, motion=motion
        )
