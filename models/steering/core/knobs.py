"""Knobs: the options of a network, with types and defaults. They are keys of a model's entry in params.yaml."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import BaseModel, ConfigDict, Field
from torch import nn

from models.steering.core.batch import Kind

Count = Annotated[int, Field(ge=1, le=1024)]  # neurons, channels
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Widths = Annotated[tuple[Count, ...], Field(min_length=1, max_length=32)]
"""Channels after each layer."""


class Group(BaseModel):
    """Options below one key, for example `wiring`."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


@dataclass(frozen=True)
class Sizes:
    """Sizes that a network takes from its input and from the general keys of its entry."""

    features: int  # F, numbers per frame between the two networks
    window: int = 1  # T, frames per prediction
    levels: int = 0  # samplings in an input of kind pointnet2
    image_size: tuple[int, int] = (0, 0)  # (H,W) pixels of an input of kind image


class NetworkKnobs(Group):
    """Base class of the class `Knobs` in a network's file: an option per field, and how to build the network."""

    kind: ClassVar[Kind | None] = None
    """What the network reads. Spatial networks only."""

    def build(self, sizes: Sizes) -> nn.Module:
        """Build the network with new weights from torch's random state."""
        raise NotImplementedError
