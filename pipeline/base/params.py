"""Read ``params.yaml``.

A section is a typed class in its stage's ``settings.py``, and a stage loads only its own.
"""

import copy
import os
import re
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from pipeline.base.errors import InputError, closest, error_context


def check_name(name: Any) -> str:
    """Return the name of an entry or a drive if it is safe for a stage, a folder and a shell.

    Raises InputError if it is not.
    """
    if isinstance(name, str) and re.fullmatch("[A-Za-z0-9][A-Za-z0-9_-]*", name):
        return name
    raise InputError("expected letters A-Z and a-z, digits, _ and -; quote names such as 1 or on")


Name = Annotated[str, BeforeValidator(check_name)]
Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Seed = Annotated[int, Field(ge=0)]
_Side = Annotated[int, Field(ge=32, le=4096)]
# Height and width of images in pixels. Not strict, as a strict tuple takes no YAML list.
ImageSize = Annotated[tuple[_Side, _Side], Field(strict=False)]
SPLITS = ("train", "val", "test")
# Largest relative difference between the frame rates of training drives, and between their rate and
# a recording's.
RATE_TOLERANCE = 0.2
# Advice for a missing section or key.
_COPY = "Copy it from the project's own params.yaml"


class Section(BaseModel):
    """One section of the params file, or one entry of a mapping section.

    Types are strict: neither a number in quotes nor ``true`` is accepted as a number.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, value: Any) -> Any:
        """Report an unknown key before a missing one: it may be the missing key, misspelt."""
        if not isinstance(value, dict) or cls.model_config["extra"] != "forbid":
            return value
        keys = [field.alias or name for name, field in cls.model_fields.items()]
        for key in value:
            if key not in keys:
                raise ValueError(f"unknown key {key!r}: {closest(str(key), keys)}")
        return value


S = TypeVar("S", bound=Section)
M = TypeVar("M", bound=BaseModel)


def load_section(section: type[S], path: Path) -> S:
    """Read the section of the params file at `path` that has the name of the class.

    Raises InputError if it is missing or invalid.
    """
    content = read_yaml(path)
    key = section.__name__.lower()
    if key not in content:
        names = [str(name) for name in content]
        raise InputError(f"no section {key!r}: {closest(key, names)}", path, _COPY)
    return parse(section, content[key], where=key, path=path)


def load_entry(kind: type[S], mapping: str, name: str, path: Path) -> S:
    """Read one entry of a mapping section, for instance variant `name` of ``graphs``.

    Raises InputError if it is missing or invalid.
    """
    content = read_entries(mapping, path)
    if name not in content:
        raise InputError(f"{mapping} has no entry {name!r}: {closest(name, list(content))}", path)
    return parse(kind, content[name], where=f"{mapping}.{name}", path=path)


def entry_name(name: str | None) -> str:
    """Return the name of an entry: `name`, or for None the one in DVC's variable, as train@NAME.

    So no command of dvc.yaml needs the syntax of a shell. Raises InputError if there is none.
    """
    _, _, entry = os.environ.get("DVC_STAGE", "").partition("@")
    name = name or entry
    if not name:
        raise InputError("the name of an entry is missing", fix="Pass it: python -m STAGE NAME")
    return name


def read_entries(mapping: str, path: Path) -> dict[str, Any]:
    """Return name → content of a mapping section (``graphs`` or ``models``), in the file's order.

    Raises InputError if there is none, or a name is invalid.
    """
    content = read_yaml(path).get(mapping)
    if not isinstance(content, dict) or not content:
        problem = f"section {mapping!r} is missing or empty: it needs at least one entry"
        raise InputError(problem, path)
    for name in content:
        with error_context(f"{path}: {mapping}: name {name!r}"):
            check_name(name)
    return content


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the sections of a YAML 1.2 file.

    Raises InputError if the file is missing, invalid or has no sections.
    """
    if not path.is_file():
        fix = f"Run from the repository's root, or: git checkout {path.name}"
        raise InputError("file is missing", path, fix)
    # Imported only here, as workers read no YAML.
    from ruamel.yaml.error import YAMLError

    try:
        parsed = _parse_yaml(path.read_text("utf-8-sig"))
    except (YAMLError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark else path
        problem = getattr(error, "problem", error)
        raise InputError(f"invalid YAML: {problem}", where) from error
    content = copy.deepcopy(parsed)  # callers may change it
    if not isinstance(content, dict):
        raise InputError("expected sections", path)
    return content


@cache
def _parse_yaml(text: str) -> Any:
    from ruamel.yaml import YAML

    return YAML(typ="safe", pure=True).load(text)


def parse(kind: type[M], value: Any, where: str = "", path: Path | None = None) -> M:
    """Validate `value` at the dotted key `where` of the file at `path`. Raises InputError."""
    try:
        return kind.model_validate(value)
    except ValidationError as error:
        first = error.errors()[0]
        keys = [str(key) for key in (where, *first["loc"]) if key not in ("", "[key]")]
        place = ".".join(keys)
        if path:
            place = f"{path}: {place}" if place else str(path)
        problem = first["msg"].removeprefix("Value error, ")
        if not isinstance(first["input"], dict):  # a complete section is too long for a message
            problem += f" (got {first['input']!r:.80})"
        fix = _COPY if first["type"] == "missing" else ""
        raise InputError(problem, place, fix) from error


def from_python(kind: type[S], options: dict[str, Any]) -> S:
    """Validate options that have the names of the fields. None means that an option is not given.

    Raises TypeError for an unknown name, InputError for an invalid value.
    """
    content = {}
    for name, value in options.items():
        if name not in kind.model_fields:
            raise TypeError(f"unknown option {name!r}: {closest(name, [*kind.model_fields])}")
        if value is not None:
            key = kind.model_fields[name].alias or name
            content[key] = value
    return parse(kind, content)
