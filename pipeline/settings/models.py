"""Section ``models``: the networks, one entry each."""

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from pipeline.base.errors import InputError, closest
from pipeline.base.params import Count, Rate, Section, parse

if TYPE_CHECKING:
    from models.steering.core.options import NetworkOptions
    from models.steering.core.steering_net import SteeringNet

FRAMES = {"graph": "kNN graphs", "pointnet2": "points with neighbourhood: pointnet2", "image": "images"}


class Entry(Section):
    """One entry of ``models``: a spatial and a temporal network on a graph variant.

    Further keys are options of the two networks: the fields of class Options in models/steering/spatial/<spatial>.py
    and models/steering/temporal/<temporal>.py. A validated entry has them all.
    """

    model_config = ConfigDict(extra="allow")
    # No defaults: dvc.yaml takes these three from params.yaml.
    input: str
    spatial: str
    temporal: str
    window: Annotated[int, Field(ge=1, le=256)] = 8  # frames per prediction
    equivariant: bool = False  # the output is odd under left-right mirroring
    learning_rate: Rate | None = None  # overrides train.learning_rate
    alpha: Annotated[float, Field(ge=0, le=100)] = 0.0  # per rad; weight exp(alpha |steering|) of eq. 9
    features: Annotated[int, Field(ge=1, le=1024)] = 32  # numbers per frame between the two networks
    predict: Literal["angle", "path"] = (
        "angle"  # path: mean curvature of the path ahead in the ranges of labels.ahead_m
    )
    horizon: Annotated[int, Field(ge=0, le=10_000)] = 0  # frames between the last input frame and the predicted angle
    motion: Literal["none", "visual"] = "none"  # visual: measured motion is an input, too
    # Value that the output is added to: the last frame's measured angle (0 without motion) or, for motion whose speed
    # is uncertain, 0. For a path, its regression on this angle.
    base: Literal["motion", "none"] = "motion"
    # another: a control that gets the scene of another frame of the drive, in training a random one, otherwise the one
    # half a drive away.
    scene: Literal["same", "another"] = "same"
    uncertainty: bool = False  # predict the standard deviation of the error, too
    # others: leave-one-out, a network per test drive, trained on the other test drives without validation; both:
    # leave-one-out on training and test drives.
    fit_to: Literal["train", "others", "both"] = "train"
    roads: Count | None = None  # use only the first n training drives; null: all

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.roads is not None and self.fit_to == "others":
            raise ValueError("roads limits the training drives, and fit_to: others uses none: remove one of the two")
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
        networks = _networks(value["spatial"], value["temporal"])
        known = [*cls.model_fields, *(name for network in networks for name in network.model_fields)]
        for key in value:
            if key not in known:
                where = f"spatial = {value['spatial']}, temporal = {value['temporal']}"
                raise ValueError(f"unknown key {key!r} for {where}: {closest(str(key), known)}")
        complete = dict(value)
        for network in networks:
            for name, field in network.model_fields.items():
                if field.is_required() and name not in value:
                    raise ValueError(f"{name} is missing: {field.description}")
            given = {name: value[name] for name in network.model_fields if name in value}
            try:
                options = parse(network, given, "")  # type: ignore[type-var]
            except InputError as error:
                raise ValueError(f"{error.where}: {error.problem}") from error
            complete |= options.model_dump()
        return complete

    @property
    def reading(self) -> dict[str, Any]:
        """Return the keyword arguments of labelled_drive.read_drive."""
        return {name: getattr(self, name) for name in ("horizon", "motion", "base", "predict", "scene")}

    def build(
        self, kind: str, levels: int = 0, image_size: tuple[int, int] | None = None, outputs: int = 1
    ) -> "SteeringNet":
        """Build the network with new weights from torch's random state.

        Args:
            kind, levels, image_size: of the frames in the entry's input, see graph_file.Contents.
            outputs: R ranges of a path.
        Raises:
            ValueError: the network reads frames of another kind, or an option is out of range.
        """
        from models.steering.core import options, steering_net  # imports torch

        spatial, temporal = (
            network.model_validate({name: getattr(self, name) for name in network.model_fields})
            for network in _networks(self.spatial, self.temporal)
        )
        expected = spatial.kind
        if expected != kind:
            holds = f"input: {self.input} holds {FRAMES[kind]}"
            raise ValueError(f"spatial = {self.spatial!r} expects {FRAMES[str(expected)]}, but {holds}")
        return steering_net.SteeringNet(
            spatial,
            temporal,
            options.Sizes(self.features, self.window, levels, image_size or (0, 0), outputs),
            equivariant=self.equivariant,
            motion=self.motion != "none",
            uncertainty=self.uncertainty,
        )


def _networks(spatial: str, temporal: str) -> "tuple[type[NetworkOptions], type[NetworkOptions]]":
    from models.steering.core import options  # imports torch

    return options.load("spatial", spatial), options.load("temporal", temporal)
