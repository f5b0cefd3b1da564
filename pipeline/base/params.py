"""Reading ``params.yaml``: each section is a typed class in ``pipeline/sections/``, and a stage loads only its own.

Units stand in names or descriptions; a value out of range, an unknown key or a wrong type is an
:class:`~pipeline.base.errors.InputError` that names file, key, value and what is allowed.
"""

import re
from datetime import date
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, TypeVar, Union, get_args, get_origin

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from pipeline.base import yaml_file
from pipeline.base.errors import InputError, closest, error_context

_DRIVE = "^[0-9]{4}_(0[1-9]|1[0-2])_(0[1-9]|[12][0-9]|3[01])_drive_[0-9]{4}$"


def _on_a_day(drive: str) -> str:
    date(*map(int, drive[:10].split("_")))  # its ValueError says which part is out of range
    return drive


Drive = Annotated[str, Field(pattern=_DRIVE, description="as 2011_09_26_drive_0052"), AfterValidator(_on_a_day)]
Positive = Annotated[float, Field(gt=0, le=1e6)]
Rate = Annotated[float, Field(gt=0, le=10, description="of learning")]
Count = Annotated[int, Field(ge=1, le=10**9)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Side = Annotated[int, Field(ge=32, le=4096)]
ImageSize = Annotated[tuple[Side, Side], Field(description="[H, W] in pixels")]
_QUOTED = 80  # characters of a wrong value
NAME = re.compile("[A-Za-z0-9][A-Za-z0-9_-]*")  # what DVC can address in a stage's name, and no shell misreads
SPLITS = ("train", "val", "test")


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    key: ClassVar[str]


S = TypeVar("S", bound=Section)

SECTIONS = (
    "town", "ingest", "labels", "encoder", "perception", "motion", "clouds", "pictures", "graphs", "models", "train",
    "evaluate",
)  # fmt: skip


def load(section: type[S], path: Path) -> S:
    """Read one section of the params file at `path`. Raises InputError as the module says."""
    content = _read(path)
    if section.key not in content:
        raise InputError(f"{path} has no section {section.key!r}: take it from the project's own params.yaml")
    with error_context(str(path)):
        return parse(section, content[section.key], section.key)


def load_entry(kind: type[S], mapping: str, name: str, path: Path) -> S:
    """Read one entry of a mapping section, for instance variant `name` of ``graphs``. Raises InputError."""
    content = _read(path)
    _check_name(name, mapping, path)
    entries = content.get(mapping)
    if not isinstance(entries, dict) or name not in entries:
        known = list(entries) if isinstance(entries, dict) else []
        raise InputError(f"{path}: {mapping} has no {name!r}: {closest(name, known)}")
    with error_context(str(path)):
        return parse(kind, entries[name], f"{mapping}.{name}")


def names(mapping: str, path: Path) -> list[str]:
    """Return the names in a mapping section (``graphs`` or ``models``), in the file's order. Raises InputError."""
    entries = _read(path).get(mapping)
    if not isinstance(entries, dict) or not entries:
        raise InputError(f"{path}: section {mapping!r} is missing or empty: it needs at least one entry")
    for name in entries:
        _check_name(name, mapping, path)
    return list(entries)


def _check_name(name: Any, mapping: str, path: Path) -> None:
    """It becomes part of folder names, stage names and commands. YAML reads 1 and on, without quotes, as no text."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise InputError(
            f"{path}: section {mapping!r}: the name {name!r} is not allowed: take letters A-Z and a-z, digits, _ and "
            f"-, starting with a letter or digit{'' if isinstance(name, str) else ', and put it in quotes'}"
        )


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(f"{path} is missing: run from the repository's root, or: git checkout {path.name}")
    content = yaml_file.read(path)
    if not isinstance(content, dict):
        raise InputError(f"{path} holds no sections")
    for name in content:
        if name not in SECTIONS:
            raise InputError(f"{path}: unknown section {name!r}: {closest(str(name), SECTIONS)}")
    return content


def parse(kind: type[S], value: Any, where: str) -> S:
    """Return `value`, which stands at the dotted key `where`, as a `kind`. Raises InputError, caused by pydantic's."""
    try:
        return kind.model_validate(value)
    except ValidationError as error:
        first = fault(error)
        key = ".".join(str(part) for part in (where, *first["loc"]) if part != "")
        if first["type"] == "extra_forbidden":
            section: Any = kind
            for part in first["loc"][:-1]:
                of_a_mapping = get_origin(section) is dict
                section = get_args(section)[1] if of_a_mapping else without_none(section.model_fields[part].annotation)
            known = list(section.model_fields)
            raise InputError(f"unknown key {key}: {closest(str(first['loc'][-1]), known)}") from error
        if first["type"] == "missing":
            raise InputError(f"{key} is missing: take it from the project's own params.yaml") from error
        # A rule on a whole section would print all of it.
        value = "" if isinstance(first["input"], dict) else f" = {_shortened(first['input'])}"
        raise InputError(f"{key}{value}: {first['msg'].removeprefix('Value error, ')}") from error


def _shortened(value: Any) -> str:
    """Return a value as a message quotes it."""
    text = repr(value)
    return text if len(text) <= _QUOTED else f"{text[:_QUOTED]}…"


def fault(error: ValidationError) -> ErrorDetails:
    """Return the one of its faults that is worth a line: an unknown key explains the one that is missing."""
    faults = error.errors()
    return next((one for one in faults if one["type"] == "extra_forbidden"), faults[0])


def without_none(annotation: Any) -> Any:
    """Return X of ``X | None``, and any other type as it is."""
    if get_origin(annotation) not in (Union, UnionType):
        return annotation
    return next(kind for kind in get_args(annotation) if kind is not NoneType)
