"""Read ``params.yaml``: each section is a typed class in ``pipeline/settings/``, and a stage loads only its own.

A fault is an InputError with file, key, value and the expected values.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args, get_origin

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from pipeline.base.errors import InputError, closest, error_context
from pipeline.base.files import read_yaml


def matches(pattern: str, expected: str) -> AfterValidator:
    """Return a validator of text by a regular expression; its error names in words what is `expected`."""

    def check(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise ValueError(f"expected {expected}")
        return text

    return AfterValidator(check)


def check_name(name: Any) -> str:
    """Return a name of an entry. Raises ValueError."""
    if isinstance(name, str) and re.fullmatch("[A-Za-z0-9][A-Za-z0-9_-]{,99}", name):
        return name
    raise ValueError("expected at most 100 letters A-Z and a-z, digits, _ and -; quote names such as 1 or on")


Name = Annotated[str, BeforeValidator(check_name)]
"""A name that is safe as the name of a stage and of a folder, and in a shell."""
Drive = Annotated[str, matches(r"\d{4}_\d\d_\d\d_drive_\d{4}", "a drive's name, such as 2011_09_26_drive_0052")]
Positive = Annotated[float, Field(gt=0, le=1e6)]
Rate = Annotated[float, Field(gt=0, le=10, description="learning rate")]
Count = Annotated[int, Field(ge=1, le=10**9)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Side = Annotated[int, Field(ge=32, le=4096)]
# YAML has lists only, which a strict model would not take as tuples.
ImageSize = Annotated[tuple[Side, Side], Field(strict=False, description="[H, W] in pixels")]
FrameKind = Literal["graph", "pointnet2", "image"]
"""Inputs of the networks, as in models/steering/core/batch.py."""
Precision = Literal["auto", "float32"]
SPLITS = ("train", "val", "test")
_COPY = "Copy it from the project's own params.yaml"


class Section(BaseModel):
    """One section of the params file, or one entry of a mapping section. Numbers in quotes and true are no numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
    key: ClassVar[str]


S = TypeVar("S", bound=Section)


def load(section: type[S], path: Path) -> S:
    """Read one section of the params file at `path`. Raises InputError."""
    content = read(path)
    if section.key not in content:
        raise InputError(f"no section {section.key!r}: {closest(section.key, [*map(str, content)])}", path, _COPY)
    return parse(section, content[section.key], section.key, path)


def load_entry(kind: type[S], mapping: str, name: str, path: Path) -> S:
    """Read one entry of a mapping section, for instance variant `name` of ``graphs``. Raises InputError."""
    content = entries(mapping, path)
    if name not in content:
        raise InputError(f"{mapping} has no entry {name!r}: {closest(name, list(content))}", path)
    return parse(kind, content[name], f"{mapping}.{name}", path)


def entries(mapping: str, path: Path) -> dict[str, Any]:
    """Return name → content of a mapping section (``graphs`` or ``models``), in the file's order. Raises InputError."""
    content = read(path).get(mapping)
    if not isinstance(content, dict) or not content:
        raise InputError(f"section {mapping!r} is missing or empty: it needs at least one entry", path)
    for name in content:
        with error_context(f"{path}: {mapping}: name {name!r}"):
            check_name(name)
    return content


def read(path: Path) -> dict[str, Any]:
    """Return the content of a params file or a preset. Raises InputError if it is missing or has no sections."""
    if not path.is_file():
        raise InputError("file is missing", path, f"Run from the repository's root, or: git checkout {path.name}")
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise InputError("expected sections", path)
    return content


def parse(kind: type[S], value: Any, where: str, path: Path | None = None) -> S:
    """Validate `value` at the dotted key `where` of the file at `path`. Raises InputError, caused by pydantic's."""
    try:
        return kind.model_validate(value)
    except ValidationError as error:
        # An unknown key first: it may be a missing key, misspelt.
        first = min(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden")
        key = ".".join(str(part) for part in (where, *first["loc"]) if part not in ("", "[key]"))
        problem, fix = first["msg"].removeprefix("Value error, "), ""
        if first["type"] == "extra_forbidden":
            options = _keys_at(kind, first["loc"][:-1])
            problem = f"unknown key: {closest(str(first['loc'][-1]), options)}" if options else "unknown key"
        elif first["type"] == "missing":
            problem, fix = "key is missing", _COPY
        elif not isinstance(first["input"], dict):  # a complete section is too long for a message
            problem += f" (got {first['input']!r:.80})"
        raise InputError(problem, f"{path}: {key}" if path else key, fix) from error


def _keys_at(annotation: Any, loc: Sequence[int | str]) -> list[str]:
    """Return the keys of the section at the location `loc` below a section; none if a union leaves it open."""
    for part in loc:
        if get_origin(annotation) is dict:
            annotation = get_args(annotation)[1]
        elif part in getattr(annotation, "model_fields", ()):
            annotation = annotation.model_fields[part].annotation
            options = [option for option in get_args(annotation) if option is not type(None)]
            annotation = options[0] if len(options) == 1 else annotation
        else:
            return []
    return list(getattr(annotation, "model_fields", ()))
