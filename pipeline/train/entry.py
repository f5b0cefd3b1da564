"""Section ``models``, which has an entry for each model."""

from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, field_validator, model_validator

from models.steering.core import options, steering_net
from pipeline.base.errors import InputError, closest
from pipeline.base.params import Count, Rate, Section, parse
from pipeline.train.quantity import load_quantity, quantity_file
from pipeline.train.settings import Train

# Keys of section train that an entry overrides.
OVERRIDES = ("learning_rate", "epochs", "span_windows", "batch_spans")
# Kind of frames → its name in messages.
FRAMES = {"graph": "points", "image": "images"}


class Entry(Section):
    """One entry of ``models``: a spatial and a temporal network on a graph variant.

    Further keys are fields of the class Options of the two networks. A validated entry has all of
    these fields, with their defaults.
    """

    model_config = ConfigDict(extra="allow")
    # These three have no defaults, because dvc.yaml reads them from params.yaml.
    input: str
    spatial: str
    temporal: str
    # Number of frames in a window.
    window: Annotated[int, Field(ge=1, le=256)] = 8
    # Whether the output is odd under left-right mirroring.
    equivariant: bool = False
    # These override the keys of section train.
    learning_rate: Rate | None = None
    epochs: Count | None = None
    span_windows: Count | None = None
    batch_spans: Count | None = None
    # Exponent per rad of the weight exp(alpha |steering|), eq. 9.
    alpha: Annotated[float, Field(ge=0, le=100)] = 0.0
    # Number of features per frame, between the two networks.
    features: Annotated[int, Field(ge=1, le=1024)] = 32
    # Quantity that the network predicts, a file of pipeline/train/quantities.
    predict: str = "angle"
    # Frames between the last input frame and the frame of the predicted quantity.
    horizon: Annotated[int, Field(ge=0, le=10_000)] = 0
    # Motion that the network gets beside the frames: none, or motion measured from images.
    motion: Literal["none", "visual"] = "none"
    # Value to which the network's output is added. `motion`: the measured angle of the window's
    # last frame, or for a path the curvature that a regression predicts from it. `none`: 0.
    base: Literal["motion", "none"] = "motion"

    @field_validator("predict")
    @classmethod
    def _check_predict(cls, name: str) -> str:
        load_quantity(name)
        return name

    @model_validator(mode="after")
    def _check_quantity(self) -> Self:
        quantity = load_quantity(self.predict)
        for key in quantity.excluded_keys:
            value = getattr(self, key)
            if value:
                text = f"predict: {self.predict} has no {key} (got {value}): remove {key}"
                raise ValueError(text)
        if self.equivariant and not quantity.is_odd:
            text = f"predict: {self.predict} does not change its sign in the mirror image"
            raise ValueError(f"{text}: remove equivariant")
        return self

    @model_validator(mode="before")
    @classmethod
    def _add_options(cls, value: Any) -> Any:
        """Add the defaults of the networks' options. Raises ValueError for a wrong key or value."""
        if not isinstance(value, dict) or not {"spatial", "temporal"} <= value.keys():
            return value
        spatial = options.load_options("spatial", value["spatial"])
        temporal = options.load_options("temporal", value["temporal"])
        fields = spatial.model_fields | temporal.model_fields
        # The weight of classes may stay where a network that reads none replaces one that does.
        if spatial.kind == "image" or not spatial.sees_frames:
            value = {key: value[key] for key in value if key != "semantics"}
        keys = [*cls.model_fields, *fields]
        for key in value.keys() - keys:
            where = f"spatial = {value['spatial']}, temporal = {value['temporal']}"
            raise ValueError(f"unknown key {key!r} for {where}: {closest(str(key), keys)}")
        for name, field in fields.items():
            if field.is_required() and name not in value:
                raise ValueError(f"{name} is missing: {field.description}")

        complete = dict(value)
        for network in (spatial, temporal):
            given = {key: value[key] for key in network.model_fields if key in value}
            complete |= parse(network, given).model_dump()
        return complete

    @property
    def predicts_ahead(self) -> bool:
        """Whether targets lie ahead of the last frame of their windows."""
        return self.horizon > 0 or load_quantity(self.predict).is_ahead

    @property
    def networks(self) -> list[str]:
        """The files of the two networks."""
        return [
            f"models/steering/spatial/{self.spatial}.py",
            f"models/steering/temporal/{self.temporal}.py",
        ]

    @property
    def files(self) -> list[str]:
        """The files that the entry names: those of the networks and of the quantity."""
        return [*self.networks, quantity_file(self.predict)]

    def override(self, settings: Train) -> Train:
        """Return the settings of the entry's training."""
        given = {key: getattr(self, key) for key in OVERRIDES if getattr(self, key) is not None}
        return settings.model_copy(update=given)

    def seeded(self, seed: int) -> Self:
        """Return the entry with `seed` for the wiring of an NCP, unless it has one."""
        wiring = (self.model_extra or {}).get("wiring")
        if wiring is None or wiring["seed"] is not None:
            return self
        return self.model_copy(update={"wiring": wiring | {"seed": seed}})

    def build(
        self,
        kind: str,
        image_size: tuple[int, int] | None = None,
        outputs: int = 1,
    ) -> steering_net.SteeringNet:
        """Build the network with new weights from torch's random state.

        `kind` and `image_size` describe the frames of the entry's input, see
        graph_file.Contents. `outputs` is R, the number of columns of the predicted quantity.
        Raises InputError if the network reads another kind of frames, or an option is out of range.
        """
        spatial = self.network
        temporal = self._network_options("temporal", self.temporal)
        if spatial.kind != kind:
            expects = f"spatial = {self.spatial!r} expects {FRAMES[str(spatial.kind)]}"
            raise InputError(f"{expects}, but input: {self.input} holds {FRAMES[kind]}")
        return steering_net.SteeringNet(
            spatial,
            temporal,
            options.Sizes(self.features, image_size or (0, 0), outputs),
            equivariant=self.equivariant,
            motion=self.motion != "none",
        )

    def start(self, net: steering_net.SteeringNet) -> None:
        """Load the weights with which the training of a network starts, if it has some."""
        self._network_options("spatial", self.spatial).start(net.spatial)
        self._network_options("temporal", self.temporal).start(net.temporal)

    @property
    def network(self) -> options.NetworkOptions:
        """The options of the spatial network."""
        return self._network_options("spatial", self.spatial)

    def _network_options(
        self, part: Literal["spatial", "temporal"], name: str
    ) -> options.NetworkOptions:
        """Return the options of one of the two networks."""
        network = options.load_options(part, name)
        return network.model_validate({key: getattr(self, key) for key in network.model_fields})
