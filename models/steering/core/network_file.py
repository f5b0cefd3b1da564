"""A network is a file, found by the name that a model's line of params.yaml calls it."""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any, Literal

from models.steering.core.knobs import checked, meant

Part = Literal["spatial", "temporal", "cell"]
# Cells lie within core: DVC cannot depend on a file that a key names which a line may lack.
PACKAGES: dict[Part, str] = {
    "spatial": "models.steering.spatial",
    "temporal": "models.steering.temporal",
    "cell": "models.steering.core.cell",
}


def names(part: Part) -> list[str]:
    """Return the names of the part's files, sorted; what is no plain name is no network."""
    folder = importlib.import_module(PACKAGES[part])
    files = [module.name for module in pkgutil.iter_modules(folder.__path__) if not module.ispkg]
    return sorted(name for name in files if re.fullmatch(r"\w+", name, re.ASCII))


def load(part: Part, name: str) -> ModuleType:
    """Import the file of this name. Raises ValueError, with what may have been meant, if there is none."""
    known = names(part)
    if name not in known:
        hint = meant(name, known, "choose one, or add a file")
        folder = PACKAGES[part].replace(".", "/")
        raise ValueError(f"{part} = {name!r} is not in {folder} ({', '.join(known)}): {hint}")
    return importlib.import_module(f"{PACKAGES[part]}.{name}")


def constructor(module: ModuleType, called: str) -> Callable[..., Any]:
    """Return the class or function `called` of a network's file. Raises ValueError if the file has none."""
    function = getattr(module, called, None)
    if not callable(function):
        raise ValueError(f"{_path(module)} defines no `{called}`: see models/steering/core/steering_net.py")
    return function


class Network:
    """What a spatial or temporal network's file offers: its knobs, and the network itself.

    Raises:
        ValueError: no file of this name, or one that is not as `models.steering.core.steering_net` says.
    """

    def __init__(self, part: Part, name: str) -> None:
        self.part, self.name, self.module = part, name, load(part, name)
        self._build = constructor(self.module, "network")
        self._given: list[str] = []  # what it takes by position
        self._knobs: dict[str, inspect.Parameter] = {}
        for parameter in inspect.signature(self._build, eval_str=True).parameters.values():
            if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                raise ValueError(f"{self.path}: network takes {parameter}: write out what it takes")
            if parameter.kind != parameter.KEYWORD_ONLY:
                self._given.append(parameter.name)
            elif parameter.empty in (parameter.annotation, parameter.default):
                raise ValueError(f"{self.path}: knob {parameter.name} of network needs a type and a default")
            else:
                self._knobs[parameter.name] = parameter

    @property
    def path(self) -> str:
        """The file, from the repository's root."""
        return _path(self.module)

    @property
    def knobs(self) -> list[str]:
        """The keys of params.yaml that mean something to this network."""
        return list(self._knobs)

    def annotation(self, knob: str) -> Any:
        """Return the type of a knob."""
        return self._knobs[knob].annotation

    def settings(self, line: Mapping[str, Any]) -> dict[str, Any]:
        """Return the value of each knob: the line's, as its type wants it, or the file's. Raises ValueError."""
        return {
            key: checked(key, knob.annotation, line[key]) if key in line else knob.default
            for key, knob in self._knobs.items()
        }

    def build(self, given: Mapping[str, Any], settings: Mapping[str, Any]) -> Any:
        """Build the network from what its data gives and the values of its knobs. Raises ValueError."""
        for name in self._given:
            if name not in given:
                raise ValueError(
                    f"{self.path}: network has a positional argument {name}, but only {', '.join(given)} are passed: "
                    "make it keyword-only with a default to use it as a knob of params.yaml"
                )
        return self._build(*(given[name] for name in self._given), **settings)


def _path(module: ModuleType) -> str:
    return f"{module.__name__.replace('.', '/')}.py"
