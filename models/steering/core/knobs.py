"""Knobs: the options of a network, with types and defaults, found by the network's name.

They are keys of a model's entry in params.yaml.
"""

import importlib
import pkgutil
import re
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field
from torch import nn

from models.steering.core.batch import Kind

Part = Literal["spatial", "temporal"]
Count = Annotated[int, Field(ge=1, le=1024)]  # neurons, channels
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Widths = Annotated[tuple[Count, ...], Field(min_length=1, max_length=32, strict=False)]
"""Channels after each layer."""


class Group(BaseModel):
    """Options below one key, for example `wiring`."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


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


def names(part: Part) -> list[str]:
    """Return the names of the part's networks, sorted. Files with other characters than [A-Za-z0-9_] are skipped."""
    folder = importlib.import_module(f"models.steering.{part}")
    files = [module.name for module in pkgutil.iter_modules(folder.__path__) if not module.ispkg]
    return sorted(name for name in files if re.fullmatch(r"\w+", name, re.ASCII))


def load(part: Part, name: str) -> type[NetworkKnobs]:
    """Return the class `Knobs` of a network's file. Raises ValueError if file or class is missing or incomplete."""
    path = f"models/steering/{part}/{name}.py"
    if name not in (known := names(part)):
        raise ValueError(f"{part} = {name!r}: there is no {path} (known: {', '.join(known)})")
    knobs = getattr(importlib.import_module(f"models.steering.{part}.{name}"), "Knobs", None)
    if not (isinstance(knobs, type) and issubclass(knobs, NetworkKnobs)):
        raise ValueError(f"{path} defines no class Knobs(NetworkKnobs), see models/steering/core/steering_net.py")
    if part == "spatial" and knobs.kind not in (kinds := get_args(Kind)):
        raise ValueError(f"{path}: Knobs.kind = {knobs.kind!r}, expected one of {', '.join(kinds)}")
    return knobs
