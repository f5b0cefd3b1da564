"""Section ``models``: the networks, one entry each."""

from typing import Annotated

from pydantic import Field

from pipeline.base.params import Count, Fraction, Positive, Section, Seed


class Wiring(Section):
    """Neural circuit policy: neuron counts and fan-outs (Lechner et al. 2020)."""

    inter: Count = 12
    command: Count = 6
    sensory_fanout: Count = 6
    inter_fanout: Count = 4
    recurrent_command_synapses: Annotated[int, Field(ge=0)] = 6
    motor_fanin: Count = 6
    seed: Seed = 0


class Model(Section):
    """One entry of ``models``: a spatial and a temporal network on a graph variant."""

    input: str
    spatial: str
    temporal: str
    cell: Annotated[str, Field(description="neuron of temporal ncp: ltc | eq4 (the paper's, as printed) | cfc")] = "ltc"
    window: Annotated[int, Field(ge=1, le=256, description="frames that a prediction sees")]
    equivariant: Annotated[bool, Field(description="a mirrored world steers exactly the other way")] = False
    learning_rate: Annotated[Positive | None, Field(description="instead of train.learning_rate")] = None
    semantics: Fraction = 0.0
    alpha: Annotated[float, Field(ge=0, le=100, description="per rad; weight exp(alpha |steering|) of eq. 9")] = 0.0
    layers: list[Count] = Field(default=[32, 32, 64], min_length=1, description="widths of the spatial network gnn")
    width: Annotated[float, Field(gt=0, le=4, description="pointnet2: factor on the reference's channels")] = 1.0
    features: Count = 32
    units: Count = 32
    wiring: Wiring = Wiring()
