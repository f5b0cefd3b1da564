"""KITTI's calibration files: names with numbers, and the rectified cameras and rotations among them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.camera.images import Size

_FOCAL_PER_WIDTH = 100.0  # largest plausible ratio


def read_entries(path: Path) -> dict[str, np.ndarray]:
    """Return name → numbers [n], read by ``pykitti.utils.read_calib_file``. Raises InputError."""
    from pykitti.utils import read_calib_file  # takes a second to import

    if not path.is_file():
        raise InputError("file is missing", path)
    try:
        return dict(read_calib_file(path))
    except ValueError as error:
        raise InputError(f"is not a calibration file ({error})", path) from error


def matrix(entries: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...], path: Path) -> np.ndarray:
    """Return entry `name` of the file at `path` in this shape. Raises InputError."""
    if name not in entries:
        raise InputError(f"has no entry {name}", path)
    values = entries[name]
    if values.size != np.prod(shape) or not np.isfinite(values).all():
        raise InputError(f"{name}: expected {np.prod(shape)} finite numbers, got {values}", path)
    return values.reshape(shape)


def projection(entries: Mapping[str, np.ndarray], number: int, path: Path) -> tuple[np.ndarray, Size]:
    """Return P_rect [3,4] of a rectified camera and its image size (H, W). Raises InputError."""
    P = matrix(entries, f"P_rect_{number:02d}", (3, 4), path)
    width, height = np.rint(matrix(entries, f"S_rect_{number:02d}", (2,), path)).astype(int).tolist()
    check_pinhole(P[:, :3], (height, width), f"{path}: P_rect_{number:02d}")
    return P, (height, width)


def check_pinhole(K: np.ndarray, size: Size, where: str) -> None:
    """Raise InputError if K [3,3] is implausible for images of `size` (H, W): focal length, centre, skew."""
    height, width = size
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    pinhole = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    focal = min(fx, fy) > 1 and max(fx, fy) < _FOCAL_PER_WIDTH * width  # false for NaN
    if not (focal and 0 <= cx <= width and 0 <= cy <= height and np.allclose(K, pinhole, atol=1e-3)):
        raise InputError(
            f"implausible intrinsics: focal lengths {fx:g}, {fy:g} (expected 1 to {_FOCAL_PER_WIDTH * width:g}), "
            f"centre {cx:g}, {cy:g} (expected within {width} x {height} pixels)",
            where,
        )


def write_entries(path: Path, entries: Mapping[str, str | np.ndarray]) -> None:
    """Write the entries in one step: text unchanged, numbers with 13 digits."""
    lines = []
    for name, value in entries.items():
        text = value if isinstance(value, str) else " ".join(f"{number:.12e}" for number in value.ravel())
        lines.append(f"{name}: {text}\n")
    with replacing(path) as tmp:
        tmp.write_text("".join(lines), encoding="ascii")
