"""Read and write KITTI's calibration files, which have lines "name: numbers"."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError, error_context
from pipeline.base.store import replacing
from pipeline.camera.camera import Camera, camera_height
from pipeline.camera.geometry import rigid
from pipeline.camera.pinhole import check_pinhole

# Name of the file with the cameras' calibration, in the folder of a date.
CALIBRATION = "calib_cam_to_cam.txt"
# First line of this file if stage sample rendered the drives of the date.
RENDERED = "dataset: sample"


def read_calibration(folder: Path, number: int) -> Camera:
    """Read camera `number` from a date folder's files.

    The entries camera_height_NN and horizon_NN, which KITTI itself lacks, take precedence over what
    the others imply. Raises InputError for missing or wrong entries.
    """
    path = folder / CALIBRATION
    velo_path = folder / "calib_velo_to_cam.txt"
    with error_context(fix="Extract the date's calibration archive (…_calib.zip) again"):
        entries = read_entries(path)
        P = parse_matrix(entries, f"P_rect_{number:02d}", (3, 4), path)
        K = P[:, :3]
        size = parse_matrix(entries, f"S_rect_{number:02d}", (2,), path)
        width, height = np.rint(size).astype(int).tolist()
        camera = Camera(K, (height, width))
        check_pinhole(K, camera.size, f"{path}: P_rect_{number:02d}")
        if velo_path.exists():
            T_cam_velo = _read_scanner(velo_path, entries, P, path)
            camera = replace(camera, T_cam_velo=T_cam_velo).at_height(camera_height(T_cam_velo))

        height = f"camera_height_{number:02d}"
        horizon = f"horizon_{number:02d}"
        if height in entries:
            camera = camera.at_height(float(parse_matrix(entries, height, (1,), path)[0]))
        if horizon in entries:
            camera = replace(camera, horizon=float(parse_matrix(entries, horizon, (1,), path)[0]))
        return camera


def _read_scanner(
    velo_path: Path, entries: Mapping[str, np.ndarray], P: np.ndarray, path: Path
) -> np.ndarray:
    """Return the transform [4,4] from the scanner to the camera with the projection `P` [3,4].

    `entries` are those of the cameras' file at `path`.
    """
    # P_rect = K [I | t] projects from the reference camera's frame, so t shifts points to this
    # camera. All three components of t count: with t_x alone, as in pykitti, depths are off by t_z,
    # which is 3 mm.
    shift = rigid(np.eye(3), np.linalg.solve(P[:, :3], P[:, 3]))
    rectify = rigid(parse_matrix(entries, "R_rect_00", (3, 3), path), np.zeros(3))

    velo = read_entries(velo_path)
    R = parse_matrix(velo, "R", (3, 3), velo_path)
    t = parse_matrix(velo, "T", (3,), velo_path)
    return shift @ rectify @ rigid(R, t)


def write_calibration(folder: Path, camera: Camera) -> None:
    """Write the calibration of camera 2 without a scanner, as :func:`read_calibration` reads it.

    The height over the road and the row of the horizon are written if they are known.
    """
    height, width = camera.size
    entries: dict[str, str | np.ndarray] = {
        "S_rect_02": np.array([width, height], float),
        "P_rect_02": np.column_stack([camera.K, np.zeros(3)]),
    }
    if camera.height_known:
        entries["camera_height_02"] = np.array([camera.height_m])
    if camera.horizon is not None:
        entries["horizon_02"] = np.array([camera.horizon])
    write_entries(folder / CALIBRATION, entries)


def read_entries(path: Path) -> dict[str, np.ndarray]:
    """Return name → numbers [n], read by ``pykitti.utils.read_calib_file``. Raises InputError."""
    from pykitti.utils import read_calib_file  # takes a second to import

    if not path.is_file():
        raise InputError("file is missing", path)
    try:
        return dict(read_calib_file(path))
    except ValueError as error:
        raise InputError(f"is not a calibration file ({error})", path) from error


def parse_matrix(
    entries: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...], path: Path
) -> np.ndarray:
    """Return entry `name` of the file at `path` in this shape. Raises InputError."""
    if name not in entries:
        raise InputError(f"has no entry {name}", path)
    values = entries[name]
    if values.size != np.prod(shape) or not np.isfinite(values).all():
        raise InputError(f"{name}: expected {np.prod(shape)} finite numbers, got {values}", path)
    return values.reshape(shape)


def write_entries(path: Path, entries: Mapping[str, str | np.ndarray]) -> None:
    """Write the entries in one step: text unchanged, numbers with 13 digits."""
    with replacing(path) as tmp, tmp.open("w", encoding="ascii") as file:
        for name, value in entries.items():
            if not isinstance(value, str):
                value = " ".join(f"{number:.12e}" for number in value.ravel())
            file.write(f"{name}: {value}\n")
