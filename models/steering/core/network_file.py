"""Find a network's file by its name in a model's entry of params.yaml."""

import importlib
import pkgutil
import re
from typing import Literal, get_args

from models.steering.core.batch import Kind
from models.steering.core.knobs import NetworkKnobs

Part = Literal["spatial", "temporal"]


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
