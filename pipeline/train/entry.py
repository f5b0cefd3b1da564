"""Section ``models``, which has an entry for each model."""

from typing import Any, Literal, Self

from pydantic import ConfigDict, Field, field_validator, model_validator

from models.steering.core import options, steering_net
from pipeline.base.errors import InputError, closest
from pipeline.base.params import Count, Positive, Section, parse
from pipeline.train.quantity import NAMES, load_quantity, quantity_file
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
    input: str = Field(description="an entry of `graphs`")
    spatial: str = Field(
        json_schema_extra={"enum": [*options.network_names("spatial")]},
        description="network of a frame, a file of `models/steering/spatial/`. `gnn` and `pyg` (a "
        "layer of PyTorch Geometric) read graphs, `pointnet2` their points only, `cnn` images. "
        "`blind` ignores the scene",
    )
    temporal: str = Field(
        json_schema_extra={"enum": [*options.network_names("temporal")]},
        description="network of a window, a file of `models/steering/temporal/`. `ncp` is a neural "
        "circuit policy",
    )
    window: int = Field(default=8, ge=1, le=256, description="frames per prediction")
    equivariant: bool = Field(
        default=False,
        description="whether a mirrored scene gives exactly the opposite angle or path",
    )
    learning_rate: Positive | None = Field(
        default=None, description="overrides `train.learning_rate`"
    )
    epochs: Count | None = Field(default=None, description="overrides `train.epochs`")
    span_windows: Count | None = Field(default=None, description="overrides `train.span_windows`")
    batch_spans: Count | None = Field(default=None, description="overrides `train.batch_spans`")
    alpha: float = Field(
        default=0.0,
        ge=0,
        le=100,
        description="α of the loss (eq. 9) per rad: a frame has the weight exp(α |angle|)",
    )
    features: int = Field(
        default=32, ge=1, le=1024, description="features per frame, between the two networks"
    )
    predict: str = Field(
        default="angle",
        json_schema_extra={"enum": [*NAMES]},
        description="quantity, a file of `pipeline/train/quantities/`. `path` is the mean "
        "curvature of the way that the car drives afterwards, one output per range of "
        "`labels.ahead_m`",
    )
    horizon: int = Field(
        default=0,
        ge=0,
        le=10_000,
        description="frames between the last input frame and the predicted value. At 10 Hz, 10 is "
        "one second ahead",
    )
    motion: Literal["none", "visual"] = Field(
        default="none",
        description="with `visual`, the measured angle, yaw rate and filtered speed of the car are "
        "inputs, too",
    )
    base: Literal["motion", "none"] = Field(
        default="motion",
        description="what the output is added to. `motion` is the measured angle of the last input "
        "frame, or for a path the curvature that a regression predicts from it (0 with `motion: "
        "none`). `none`, 0, is for drives whose measured speed is uncertain",
    )

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
