"""Read ``params.yaml``: each section is a typed class in ``pipeline/sections/``, and a stage loads only its own.

A value out of range, an unknown key or a wrong type is an :class:`~pipeline.base.errors.InputError` with file, key,
value and what is expected. Units are in names or descriptions.
"""

import re
from datetime import date
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from pipeline.base.errors import InputError, closest, error_context
from pipeline.base.files import read_yaml

_DRIVE = "^[0-9]{4}_(0[1-9]|1[0-2])_(0[1-9]|[12][0-9]|3[01])_drive_[0-9]{4}$"


def _has_valid_date(drive: str) -> str:
    date(*map(int, drive[:10].split("_")))  # its ValueError names the part that is out of range
    return drive


Drive = Annotated[str, Field(pattern=_DRIVE, description="as 2011_09_26_drive_0052"), AfterValidator(_has_valid_date)]
Positive = Annotated[float, Field(gt=0, le=1e6)]
Rate = Annotated[float, Field(gt=0, le=10, description="learning rate")]
Count = Annotated[int, Field(ge=1, le=10**9)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Side = Annotated[int, Field(ge=32, le=4096)]
ImageSize = Annotated[tuple[Side, Side], Field(description="[H, W] in pixels")]
NAME = re.compile("[A-Za-z0-9][A-Za-z0-9_-]{,99}")  # safe in a stage's name, a folder's name and a shell
SPLITS = ("train", "val", "test")
SECTIONS = (
    "town", "ingest", "labels", "encoder", "perception", "motion", "clouds", "pictures", "graphs", "models", "train",
    "evaluate",
)  # fmt: skip
_COPY = "Copy it from the project's own params.yaml"


class Section(BaseModel):
    """One section of the params file, or one entry of a mapping section."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    key: ClassVar[str]


S = TypeVar("S", bound=Section)


def load(section: type[S], path: Path) -> S:
    """Read one section of the params file at `path`. Raises InputError."""
    content = _read(path)
    if section.key not in content:
        raise InputError(f"no section {section.key!r}", path, _COPY)
    with error_context(path):
        return parse(section, content[section.key], section.key)


def load_entry(kind: type[S], mapping: str, name: str, path: Path) -> S:
    """Read one entry of a mapping section, for instance variant `name` of ``graphs``. Raises InputError."""
    content = entries(mapping, path)
    if name not in content:
        raise InputError(f"{mapping} has no entry {name!r}: {closest(name, list(content))}", path)
    with error_context(path):
        return parse(kind, content[name], f"{mapping}.{name}")


def entries(mapping: str, path: Path) -> dict[str, Any]:
    """Return name → content of a mapping section (``graphs`` or ``models``), in the file's order. Raises InputError."""
    content = _read(path).get(mapping)
    if not isinstance(content, dict) or not content:
        raise InputError(f"section {mapping!r} is missing or empty: it needs at least one entry", path)
    for name in content:
        if not isinstance(name, str) or not NAME.fullmatch(name):
            fix = "Use up to 100 letters A-Z and a-z, digits, _ and -; quote names such as 1 or on"
            raise InputError(f"section {mapping!r}: invalid name {_shorten(name)}", path, fix)
    return content


def _read(path: Path) -> dict[str, Any]:
    content = read(path)
    for name in content:
        if name not in SECTIONS:
            raise InputError(f"unknown section {name!r}: {closest(str(name), SECTIONS)}", path)
    return content


def read(path: Path) -> dict[str, Any]:
    """Return the content of a params file or a preset. Raises InputError if it is missing or has no sections."""
    if not path.is_file():
        raise InputError("file is missing", path, f"Run from the repository's root, or: git checkout {path.name}")
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise InputError("expected sections", path)
    return content


def parse(kind: type[S], value: Any, where: str) -> S:
    """Validate `value` at the dotted key `where` as a `kind`. Raises InputError, caused by pydantic's error."""
    try:
        return kind.model_validate(value)
    except ValidationError as error:
        faults = error.errors()
        # An unknown key before the key that is missing in its place.
        first = next((fault for fault in faults if fault["type"] == "extra_forbidden"), faults[0])
        key = ".".join(str(part) for part in (where, *first["loc"]) if part != "")
        if first["type"] == "extra_forbidden":
            name = str(first["loc"][-1])
            options = list(kind.model_fields) if len(first["loc"]) == 1 else []
            raise InputError(f"unknown key{f': {closest(name, options)}' if options else ''}", key) from error
        if first["type"] == "missing":
            raise InputError("key is missing", key, _COPY) from error
        # A rule on a complete section would print all of it.
        got = "" if isinstance(first["input"], dict) else f" (got {_shorten(first['input'])})"
        raise InputError(f"{first['msg'].removeprefix('Value error, ')}{got}", key) from error


def _shorten(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:80]}…"
