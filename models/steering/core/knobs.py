"""Types for the knobs of a network, and the reading of their values from a model's line of params.yaml."""

import difflib
from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

Count = Annotated[int, Field(ge=1, le=1024)]  # neurons, channels: with more, none of these networks can be built
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Widths = Annotated[tuple[Count, ...], Field(min_length=1, max_length=32)]
"""Channels after each layer."""


class Group(BaseModel):
    """Knobs that stand together under one key, as `wiring`."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def checked(key: str, annotation: Any, value: Any) -> Any:
    """Return `value` as `annotation` wants it; raise a ValueError that starts with the key if it does not."""
    try:
        return TypeAdapter(annotation).validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join([key, *map(str, first["loc"])])
        message = first["msg"].removeprefix("Value error, ")
        if first["type"] == "extra_forbidden":
            known = list(getattr(annotation, "model_fields", ()))
            message = f"{key} takes {', '.join(known)}: {meant(str(first['loc'][-1]), known, 'leave it out')}"
        raise ValueError(f"{written(where, first['input'])}: {message}") from error


def plain(annotation: Any, value: Any) -> Any:
    """Return a checked value as JSON has it: what goes into checkpoints is read again as params.yaml is."""
    return TypeAdapter(annotation).dump_python(value, mode="json")


def written(key: str, value: Any) -> str:
    """Return how an error message quotes a setting; a whole group of them would hide what is wrong."""
    return key if isinstance(value, dict) else f"{key} = {value!r}"


def meant(name: str, known: Iterable[str], otherwise: str) -> str:
    """Return the end of an error message: which of `known` may have been meant by `name`; `otherwise`, if none."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f"did you mean {near[0]}?" if near else otherwise
