"""Section ``models``: the networks, one entry each."""

from typing import Annotated

from pydantic import ConfigDict, Field

from pipeline.base.params import Count, Positive, Section


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
    learning_rate: Annotated[Positive | None, Field(description="instead of train.learning_rate")] = None
    alpha: Annotated[float, Field(ge=0, le=100, description="per rad; weight exp(alpha |steering|) of eq. 9")] = 0.0
    features: Annotated[Count, Field(description="numbers per frame from the spatial network to the temporal")] = 32
