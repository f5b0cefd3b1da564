"""Read untrusted input files: bytes up to a limit, columns of numbers from CSV files, and YAML."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import DamagedFile, InputError

MiB = 1 << 20
_MOST_YAML_BYTES = 16 * MiB


def check_file(path: Path, limit: int) -> int:
    """Return the size of a file in bytes. Raises DamagedFile if it is not a regular file or larger than `limit`.

    Raises OSError if it is missing.
    """
    if not path.is_file() and (path.exists() or path.is_symlink()):
        raise DamagedFile("expected a regular file", path)
    size = path.stat().st_size
    if size > limit:
        raise DamagedFile(f"file is too large (expected at most {limit} bytes, got {size})", path)
    return size


def read_bytes(path: Path, limit: int) -> bytes:
    """Return the content of a file after :func:`check_file`."""
    check_file(path, limit)
    return path.read_bytes()


def size_of(path: Path) -> int:
    """Return the bytes of a file, or of all files below a folder."""
    if not path.is_dir():
        return path.stat().st_size
    return sum(file.lstat().st_size for file in path.rglob("*") if not file.is_dir())


def read_columns(
    path: Path, required: Sequence[str], optional: Sequence[str], expected: str, most_bytes: int
) -> dict[str, np.ndarray]:
    """Return name → column, float64 [N], for the `required` and those of the `optional` columns that the file has.

    The separator is a comma, a semicolon or a tab; other columns are ignored. Raises InputError, which ends with the
    sentence `expected`, for a missing column, and for values that are not numbers; as :func:`check_file` does.
    """
    import pandas as pd

    check_file(path, most_bytes)
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        header = file.readline(1 << 16)
    separator = max(",;\t", key=header.count)
    names = [name.strip(' "\r\n') for name in header.split(separator)]
    missing = [name for name in required if name not in names]
    if missing:
        raise InputError(f"has no column {', '.join(missing)} (got {', '.join(names)})", path, expected)
    columns = [*required, *(name for name in optional if name in names)]
    try:
        table = pd.read_csv(
            path,
            sep=separator,
            header=0,
            names=names,
            index_col=False,
            usecols=columns,
            dtype=np.float64,
            skipinitialspace=True,
            encoding="utf-8-sig",
            encoding_errors="replace",
        )
    except ValueError as error:  # pandas' parser errors too
        raise InputError(f"is not a table of numbers ({error})", path, "Correct or remove the line") from error
    return {name: table[name].to_numpy() for name in columns}


def check_limit(
    name: str, values: np.ndarray, limit: float, path: Path, fix: str = "Correct or remove the sample"
) -> None:
    """Raise InputError if one of `values` [N] is not finite or its magnitude exceeds `limit`."""
    wrong = ~(np.abs(values) <= limit)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InputError(f"implausible {name} = {values[at]:g} at sample {at + 1} (limit ±{limit:g})", path, fix)


def check_increase(name: str, values: np.ndarray, least_step: float, path: Path) -> None:
    """Raise InputError if one of `values` [N] is less than `least_step` above the one before."""
    wrong = ~(np.diff(values) >= least_step)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InputError(
            f"{name} goes from {values[at]:.15g} to {values[at + 1]:.15g} at sample {at + 2} (expected an increase of "
            f"{least_step:g} or more)",
            path,
            "Sort the file and remove repeated rows",
        )


def read_yaml(path: Path, *, comments: bool = False) -> Any:
    """Return the content of a YAML 1.2 file, as DVC reads it, for ruamel's writer with `comments`.

    Raises InputError if it is invalid, has a key twice, or is not a regular file.
    """
    from ruamel.yaml import YAML  # here, as workers read no YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    try:
        text = read_bytes(path, _MOST_YAML_BYTES).decode("utf-8-sig")
        return YAML(typ="rt" if comments else "safe", pure=True).load(text)
    except UnicodeDecodeError as error:
        raise InputError(f"invalid UTF-8 ({error})", path) from error
    except MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise InputError(f"invalid YAML: {error.problem}", f"{path}{line}") from error
    except (YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"invalid YAML: {' '.join(str(error).split())}", path) from error
