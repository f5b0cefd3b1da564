"""Section ``models``: the networks, one entry each."""

from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from pipeline.base.errors import InputError, closest, error_context
from pipeline.base.params import Count, Rate, Section, parse


class Model(Section):
    """One entry of ``models``: a spatial and a temporal network on a graph variant.

    Further keys are knobs of the two networks, defined in models/steering/spatial/<spatial>.py and
    models/steering/temporal/<temporal>.py; :func:`resolve` validates them.
    """

    model_config = ConfigDict(extra="allow")

    input: str
    spatial: str
    temporal: str
    window: Annotated[int, Field(ge=1, le=256, description="frames per prediction")]
    equivariant: Annotated[bool, Field(description="make the output odd under left-right mirroring")] = False
    learning_rate: Annotated[Rate | None, Field(description="overrides train.learning_rate")] = None
    alpha: Annotated[float, Field(ge=0, le=100, description="per rad; weight exp(alpha |steering|) of eq. 9")] = 0.0
    features: Annotated[int, Field(ge=1, le=1024, description="numbers per frame between the two networks")] = 32
    horizon: Annotated[
        int, Field(ge=0, le=10_000, description="predict the steering this number of frames after the window")
    ] = 0
    motion: Annotated[
        Literal["none", "visual", "lidar"],
        Field(description="measured motion as a second input; the network predicts the residual to its angle"),
    ] = "none"
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


def resolve(model: Model) -> dict[str, Any]:
    """Return an entry with the values of all knobs of its networks, defaults included, as JSON-able values.

    Raises InputError, whose problem starts with the key, if a network does not exist or a knob is unknown or invalid.
    """
    from models.steering.core import knobs  # imports torch

    with error_context():
        networks = [knobs.load("spatial", model.spatial), knobs.load("temporal", model.temporal)]
    known = [knob for network in networks for knob in network.model_fields]
    names = f"spatial = {model.spatial}, temporal = {model.temporal}"
    for knob in known:
        if knob in Model.model_fields or known.count(knob) > 1:
            raise InputError(f"defined twice for {names}", knob, "Rename the knob in the network's file")
    values = model.model_extra or {}
    for key in values:
        if key not in known:
            raise InputError(f"unknown key for {names}: {closest(key, [*known, *Model.model_fields])}", key)
    line = {key: getattr(model, key) for key in Model.model_fields}
    for network in networks:
        own = {key: value for key, value in values.items() if key in network.model_fields}
        line |= parse(network, own, "").model_dump(mode="json")  # type: ignore[type-var]  # reads fields alone
    return line
