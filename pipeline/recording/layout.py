"""Write a drive's folder in KITTI raw's layout: images, oxts packets, calibration."""

from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from pipeline.base.errors import InputError
from pipeline.base.params import Drive
from pipeline.camera.images import Size, format_size, write_png
from pipeline.camera.intrinsics import write_entries
from pipeline.kitti.calibration import read_camera
from pipeline.kitti.oxts import LONGEST_STEP_S, YEARS, format_packet, format_times

CAMERA = 2  # left colour camera, the default of stage ingest
IMAGES = f"image_{CAMERA:02d}"
_FILE = "calib_cam_to_cam.txt"
_NOON_S = 12 * 3600.0  # time of day of the first image; nothing depends on it
_SAME_PX = 1e-6  # rounding of a calibration file's digits


def drive_folder(out: Path, drive: str) -> Path:
    """Return a drive's folder below `out`. Raises InputError for a name that is not like KITTI's."""
    try:
        TypeAdapter(Drive).validate_python(drive)
    except ValidationError:
        drive = ""
    if not drive or int(drive[:4]) not in YEARS:
        example = f"a date from {YEARS[0]} to {YEARS[-1]} and four digits, for instance 2027_03_31_drive_0001"
        raise InputError(f"expected {example}", "--drive")
    return out / drive[:10] / f"{drive}_sync"


def write_images(folder: Path, images: Iterable[tuple[int, np.ndarray]], threads: int) -> None:
    """Write numbered RGB images [H,W,3] as PNG files of camera 2, encoded by `threads` threads.

    At most twice as many images as threads are in memory.
    """
    data = folder / IMAGES / "data"
    data.mkdir(parents=True)
    pending: deque[Future[None]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        for number, image in images:
            if len(pending) == 2 * threads:
                pending.popleft().result()
            pending.append(pool.submit(write_png, data / f"{number:010d}.png", image))
        for future in pending:
            future.result()


def write_times(folder: Path, usable: np.ndarray, time_s: np.ndarray, sensors: Iterable[str]) -> None:
    """Write the times [F] in seconds of all images for each sensor's folder.

    Raises InputError if two of the `usable` images, bool [F], are farther apart than stage ingest accepts.
    """
    numbers = np.flatnonzero(usable)
    gaps_s = np.diff(time_s[numbers])
    if (gaps_s > LONGEST_STEP_S).any():
        at = int(np.argmax(gaps_s))
        problem = f"images {numbers[at]} and {numbers[at + 1]} are {gaps_s[at]:.0f} s apart, without motion in between"
        raise InputError(f"{problem} (limit {LONGEST_STEP_S:g} s)", fix="Import the two parts as two drives")
    for sensor in sensors:
        times = format_times(time_s - time_s[0], folder.name[:10], _NOON_S)
        (folder / sensor / "timestamps.txt").write_bytes(times)


def write_packets(folder: Path, rows: np.ndarray, usable: np.ndarray) -> None:
    """Write packets [K,30] for the `usable` images, bool [F]."""
    data = folder / "oxts" / "data"
    data.mkdir(parents=True)
    for number, row in zip(np.flatnonzero(usable), rows, strict=True):
        (data / f"{number:010d}.txt").write_bytes(format_packet(row))


def check_calibration(folder: Path, size: Size, K: np.ndarray, force: bool) -> bool:
    """Return whether the date folder of the drive at `folder` already has this calibration.

    Raises InputError if it has the calibration of another camera; with `force`, only if other drives share it.
    """
    if not (folder.parent / _FILE).is_file():
        return False
    camera = read_camera(folder.parent, CAMERA)
    if camera.size == size and np.allclose(camera.K, K, rtol=0, atol=_SAME_PX):
        return True
    others = sorted(other.name for other in folder.parent.glob("*_sync") if other != folder)
    if force and not others:
        return False
    raise InputError(
        f"date has the calibration of another camera, {_describe(camera.size, camera.K)} (this one: "
        f"{_describe(size, K)}; {f'used by {others[0]}' if others else '--force replaces it'})",
        folder.parent,
        "Pass --drive another date: all drives of a date share the calibration",
    )


def write_calibration(folder: Path, size: Size, K: np.ndarray) -> None:
    """Write calib_cam_to_cam.txt into the date folder of the drive at `folder`."""
    entries = {
        f"S_rect_{CAMERA:02d}": np.array(size[::-1], float),
        "R_rect_00": np.eye(3),
        f"P_rect_{CAMERA:02d}": np.column_stack([K, np.zeros(3)]),
    }
    write_entries(folder.parent / _FILE, entries)


def _describe(size: Size, K: np.ndarray) -> str:
    return f"{format_size(size)}, focal length {K[0, 0]:.2f}, centre {K[0, 2]:.1f}, {K[1, 2]:.1f}"
