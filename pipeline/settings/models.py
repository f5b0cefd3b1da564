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
    window: Annotated[int, Field(ge=1, le=256, description="frames per prediction")] = 8
    equivariant: Annotated[bool, Field(description="make the output odd under left-right mirroring")] = False
    learning_rate: Annotated[Rate | None, Field(description="overrides train.learning_rate")] = None
    alpha: Annotated[float, Field(ge=0, le=100, description="per rad; weight exp(alpha |steering|) of eq. 9")] = 0.0
    features: Annotated[int, Field(ge=1, le=1024, description="numbers per frame between the two networks")] = 32
    predict: Annotated[
        Literal["angle", "path"],
        Field(description="path: the mean curvature of the path ahead, in each range of labels.ahead_m"),
    ] = "angle"
    horizon: Annotated[
        int, Field(ge=0, le=10_000, description="predict the steering this number of frames after the window")
    ] = 0
    motion: Annotated[Literal["none", "visual"], Field(description="visual: measured motion is an input, too")] = "none"
    base: Annotated[
        Literal["motion", "none"],
        Field(
            description="angle that the output is added to: motion: the measured angle of the last frame, 0 without "
            "motion | none: 0, for motion whose speed is uncertain. For a path, its regression on this angle"
        ),
    ] = "motion"
    scene: Annotated[
        Literal["same", "another"],
        Field(
            description="another: a control that gets the scene of another frame of the drive, in training a random "
            "one, otherwise the one half a drive away"
        ),
    ] = "same"
    uncertainty: Annotated[bool, Field(description="predict the standard deviation of the error, too")] = False
    fit_to: Annotated[
        Literal["train", "others", "both"],
        Field(
            description="train: the training drives | others: leave-one-out, one network per test drive, trained on "
            "the other test drives without validation | both: leave-one-out on training and test drives"
        ),
    ] = "train"
    roads: Annotated[Count | None, Field(description="use only the first n training drives; null: all")] = None

    @model_validator(mode="after")
    def _check_roads(self) -> Self:
        if self.roads is not None and self.fit_to == "others":
            raise ValueError("roads limits the training drives, and fit_to: others uses none: remove one of the two")
        return self

    @model_validator(mode="after")
    def _check_path(self) -> Self:
        if self.predict == "path":
            for key, value in {"horizon": self.horizon, "alpha": self.alpha}.items():
                if value:
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
        return steering_net.build(
            spatial,
            temporal,
            options.Sizes(self.features, self.window, levels, image_size or (0, 0), outputs),
            equivariant=self.equivariant,
            motion=self.motion != "none",
            uncertainty=self.uncertainty,
            path=self.predict == "path",
        )


def _networks(spatial: str, temporal: str) -> "tuple[type[NetworkOptions], type[NetworkOptions]]":
    from models.steering.core import options  # imports torch

    return options.load("spatial", spatial), options.load("temporal", temporal)
