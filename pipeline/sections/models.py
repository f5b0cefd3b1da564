"""Section ``models``: the networks, one entry each."""

from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from pipeline.base.params import Count, Rate, Section


class Model(Section):
    """One entry of ``models``: a spatial and a temporal network on a graph variant.

    Further keys are knobs of the two networks, whose files say what there is: models/steering/spatial/<spatial>.py and
    models/steering/temporal/<temporal>.py. models/steering/core/steering_net.py checks them.
    """

    model_config = ConfigDict(extra="allow")

    input: str
    spatial: str
    temporal: str
    window: Annotated[int, Field(ge=1, le=256, description="frames that a prediction sees")]
    equivariant: Annotated[bool, Field(description="a mirrored world steers exactly the other way")] = False
    learning_rate: Annotated[Rate | None, Field(description="instead of train.learning_rate")] = None
    alpha: Annotated[float, Field(ge=0, le=100, description="per rad; weight exp(alpha |steering|) of eq. 9")] = 0.0
    features: Annotated[int, Field(ge=1, le=1024, description="numbers per frame between the two networks")] = 32
    horizon: Annotated[
        int, Field(ge=0, le=10_000, description="how many frames after the last one seen steering is predicted")
    ] = 0
    motion: Annotated[
        Literal["none", "visual", "lidar"],
        Field(description="what the car did since the frame before, by images or scans, beside what a frame shows"),
    ] = "none"
    fit_to: Annotated[
        Literal["train", "others", "both"],
        Field(
            description="training drives | for each test drive, a network fitted to the other test drives alone, which "
            "nothing validates: the last epoch counts | to both"
        ),
    ] = "train"
    roads: Annotated[Count | None, Field(description="the first so many training drives; null: all")] = None

    @model_validator(mode="after")
    def _roads_of_train(self) -> Self:
        if self.roads is not None and self.fit_to == "others":
            raise ValueError("roads counts training drives, which fit_to: others leaves out: leave out one of the two")
        return self
