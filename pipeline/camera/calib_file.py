"""KITTI's calibration files as text: lines of a name and its numbers."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError, error_context
from pipeline.base.files import MiB, check_file

_LARGEST = 1 << 15  # pixels of a side
_ROUNDED = 1e-3  # of a rotation, in text


def read_entries(path: Path) -> dict[str, np.ndarray]:
    """Return name → numbers [n], by ``pykitti.utils.read_calib_file``. Raises InputError."""
    from pykitti.utils import read_calib_file  # takes a second to import

    if not path.exists():
        raise InputError(f"{path} is missing")
    check_file(path, MiB)
    with error_context(f"{path} is not a calibration file"):
        return dict(read_calib_file(path))


def matrix(entries: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...], path: Path) -> np.ndarray:
    """Return entry `name` of the file at `path` in this shape. Raises InputError."""
    if name not in entries:
        raise InputError(f"{path} has no {name}")
    values = entries[name]
    if values.size != np.prod(shape) or not np.isfinite(values).all():
        raise InputError(f"{path}: {name} is not {np.prod(shape)} finite numbers")
    return values.reshape(shape)


def projection(entries: Mapping[str, np.ndarray], number: int, path: Path) -> tuple[np.ndarray, tuple[int, int]]:
    """Return P_rect [3,4] of a rectified camera and its images' size (H, W). Raises InputError if it is no camera's."""
    name, of_size = f"P_rect_{number:02d}", f"S_rect_{number:02d}"
    P, (width, height) = matrix(entries, name, (3, 4), path), matrix(entries, of_size, (2,), path)
    if not (1 <= width <= _LARGEST and 1 <= height <= _LARGEST):
        raise InputError(f"{path}: {of_size} says images of {width:g} x {height:g} pixels")
    fx, fy, cx, cy = P[0, 0], P[1, 1], P[0, 2], P[1, 2]
    pinhole = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    seen = 0 <= cx <= width and 0 <= cy <= height
    if not (np.allclose(P[:, :3], pinhole, atol=1e-3) and min(fx, fy) > 1 and max(fx, fy) < 100 * width and seen):
        raise InputError(
            f"{path}: {name} is not the projection of a rectified camera: focal lengths {fx:g} and {fy:g}, centre "
            f"{cx:g}, {cy:g} of {width:g} x {height:g} pixels"
        )
    if np.abs(P[:, 3]).max() > 100 * max(fx, fy):  # a camera that is 100 m from the reference camera
        raise InputError(f"{path}: {name} puts the camera {np.abs(P[:, 3]).max() / fx:g} m away from the first")
    return P, (round(height), round(width))


def rotation(entries: Mapping[str, np.ndarray], name: str, path: Path) -> np.ndarray:
    """Return entry `name` [3,3]. Raises InputError if it is not a rotation."""
    R = matrix(entries, name, (3, 3), path)
    if np.abs(R).max() > 2 or np.abs(R @ R.T - np.eye(3)).max() > _ROUNDED or np.linalg.det(R) < 0:
        raise InputError(f"{path}: {name} is not a rotation: its rows are not of length 1 and at right angles")
    return R


def write_entries(path: Path, entries: Mapping[str, str | np.ndarray]) -> None:
    """Write the entries, in one step: texts as they are, numbers with 13 digits."""
    lines = [f"{name}: {value if isinstance(value, str) else _numbers(value)}\n" for name, value in entries.items()]
    with replacing(path) as tmp:
        tmp.write_text("".join(lines), encoding="ascii")


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.12e}" for value in values.ravel())
