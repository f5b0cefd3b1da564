"""Read YAML files as YAML 1.2, as DVC does."""

from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError


def read(path: Path) -> Any:
    """Return the content of a YAML file. Raises InputError if it is invalid or has a key twice."""
    from ruamel.yaml import YAML  # here, as workers read no YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    try:
        return YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"invalid UTF-8 ({error})", path) from error
    except MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise InputError(f"invalid YAML: {error.problem}", f"{path}{line}") from error
    except (YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"invalid YAML: {' '.join(str(error).split())}", path) from error
