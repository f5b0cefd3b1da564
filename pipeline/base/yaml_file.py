"""Read YAML files as YAML 1.2, as DVC does."""

from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError


def read(path: Path) -> Any:
    """Return the content of a YAML file. Raises InputError if it is invalid or has a key twice."""
    try:
        return parse(path.read_text(encoding="utf-8-sig"), path)
    except UnicodeDecodeError as error:
        raise InputError(f"invalid UTF-8 ({error})", path) from error


def parse(text: str, path: Path) -> Any:
    """Return the content of a YAML text; errors name `path`."""
    from ruamel.yaml import YAML  # here, as workers read no YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    try:
        return YAML(typ="safe", pure=True).load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        line, problem = "", " ".join(str(error).split())
        if isinstance(error, MarkedYAMLError):
            line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
            problem = str(error.problem)
        raise InputError(f"invalid YAML: {problem}", f"{path}{line}") from error
