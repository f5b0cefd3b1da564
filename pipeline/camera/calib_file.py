"""KITTI's calibration files as text: lines of a name and its numbers."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError, explained


def read_entries(path: Path) -> dict[str, np.ndarray]:
    """Return name → numbers [n], by ``pykitti.utils.read_calib_file``. Raises InputError."""
    from pykitti.utils import read_calib_file  # takes a second to import

    if not path.is_file():
        raise InputError(f"{path} is missing")
    with explained(f"{path} is not a calibration file"):
        return dict(read_calib_file(path))


def matrix(entries: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...], path: Path) -> np.ndarray:
    """Return entry `name` of the file at `path` in this shape. Raises InputError."""
    if name not in entries:
        raise InputError(f"{path} has no {name}")
    values = entries[name]
    if values.size != np.prod(shape) or not np.isfinite(values).all():
        raise InputError(f"{path}: {name} is not {np.prod(shape)} finite numbers")
    return values.reshape(shape)


def write_entries(path: Path, entries: Mapping[str, str | np.ndarray]) -> None:
    """Write the entries, in one step: texts as they are, numbers with 13 digits."""
    lines = [f"{name}: {value if isinstance(value, str) else _numbers(value)}\n" for name, value in entries.items()]
    with replacing(path) as tmp:
        tmp.write_text("".join(lines), encoding="ascii")


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.12e}" for value in values.ravel())
