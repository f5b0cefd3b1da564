"""Write a drive's folder in KITTI raw's layout: images, oxts packets, calibration."""

from collections.abc import Generator, Iterable, Sequence
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from pipeline.base.errors import InputError
from pipeline.base.params import Drive
from pipeline.camera.camera import Camera
from pipeline.camera.images import format_size, write_png
from pipeline.camera.intrinsics import write_entries
from pipeline.kitti.oxts import (
    GRAVITY_MPS2,
    LONGEST_STEP_S,
    YEARS,
    format_packet,
    format_times,
    level_columns,
    make_rows,
)
from pipeline.kitti.raw import read_calibration
from pipeline.recording.track import Rates
from pipeline.train.prefetch import side_by_side

CAMERA = 2  # left colour camera, the default of stage ingest
IMAGES = f"image_{CAMERA:02d}"
_FILE = "calib_cam_to_cam.txt"
_NOON_S = 12 * 3600.0  # time of day of the first image; nothing depends on it
_LAST_DRIVE = 9999
_SAME_PX = 1e-6  # rounding of a calibration file's digits


def drive_folder(out: Path, drive: str, force: bool) -> Path:
    """Return a drive's folder below `out`.

    Raises InputError for a name that is not like KITTI's, or if the drive exists, unless `force`.
    """
    try:
        TypeAdapter(Drive).validate_python(drive)
    except ValidationError:
        drive = ""
    if not drive or int(drive[:4]) not in YEARS:
        example = f"a date from {YEARS[0]} to {YEARS[-1]} and four digits, for instance 2027_03_31_drive_0001"
        raise InputError(f"expected {example}", "--drive")
    folder = out / drive[:10] / f"{drive}_sync"
    if folder.exists() and not force:
        raise InputError("drive exists", folder, "Replace it with --force, or pass --drive another number")
    return folder


def consecutive(drive: str, count: int) -> list[str]:
    """Return `count` drives of a date, from `drive` on. Raises InputError beyond drive 9999."""
    first = int(drive[-4:])
    if first + count - 1 > _LAST_DRIVE:
        raise InputError(
            f"expected at most {_LAST_DRIVE - count + 1}, as the recording becomes {count} drives", "--drive"
        )
    return [f"{drive[:-4]}{first + number:04d}" for number in range(count)]


def write_images(folder: Path, images: Generator[tuple[int, np.ndarray]], threads: int) -> None:
    """Write numbered RGB images [H,W,3] as PNG files of camera 2, encoded by `threads` threads.

    At most twice as many images as threads are in memory.
    """
    data = folder / IMAGES / "data"
    data.mkdir(parents=True)

    def write(numbered: tuple[int, np.ndarray]) -> None:
        number, image = numbered
        write_png(data / f"{number:010d}.png", image)

    for _ in side_by_side(write, images, threads, ahead=2 * threads):
        pass


def distribute_images(folders: Sequence[Path], parts: Sequence[np.ndarray]) -> None:
    """Move the images of the first drive's folder to the drive of their part, masks bool [F]; delete those of none."""
    for folder in folders[1:]:
        (folder / IMAGES / "data").mkdir(parents=True)
    for path in (folders[0] / IMAGES / "data").iterdir():
        homes = [folder for folder, part in zip(folders, parts, strict=True) if part[int(path.stem)]]
        if not homes:
            path.unlink()
        elif homes[0] != folders[0]:
            path.rename(homes[0] / IMAGES / "data" / path.name)


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


def write_packets(folder: Path, rates: Rates, time_s: np.ndarray, usable: np.ndarray) -> None:
    """Write the packets of the `usable` images, bool [F], taken at `time_s` [F]."""
    data = folder / "oxts" / "data"
    data.mkdir(parents=True)
    for number, row in zip(np.flatnonzero(usable), packets(rates, time_s[usable]), strict=True):
        (data / f"{number:010d}.txt").write_bytes(format_packet(row))


def packets(rates: Rates, time_s: np.ndarray) -> np.ndarray:
    """Return the packets [F,30] of images at `time_s` [F], ascending, within the motion's times.

    Rates are interpolated linearly; heading and position are their integrals from the first sample. Height, roll,
    pitch, accuracies and receiver modes are unknown and 0.
    """
    from scipy.integrate import cumulative_trapezoid

    time_s = np.clip(time_s, rates.time_s[0], rates.time_s[-1])
    nodes_s = np.union1d(time_s, rates.time_s)
    speed, yaw_rate = (np.interp(nodes_s, rates.time_s, rate) for rate in (rates.speed_mps, rates.yaw_rate_radps))
    heading = rates.heading_rad + cumulative_trapezoid(yaw_rate, nodes_s, initial=0)
    velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    xy = cumulative_trapezoid(velocity, nodes_s, axis=0, initial=0)

    at = np.concatenate([[0], np.searchsorted(nodes_s, time_s)])  # the first sample has a known position
    speed, yaw_rate = speed[at], yaw_rate[at]
    left = speed * yaw_rate
    forward = np.concatenate([[0.0], np.gradient(speed[1:], time_s) if len(time_s) > 1 else np.zeros(1)])
    level = level_columns(xy[at], heading[at], speed, forward, left, yaw_rate, rates.latitude_deg, rates.longitude_deg)
    return make_rows(len(at), **level, ax=forward, ay=left, az=GRAVITY_MPS2)[1:]


def check_calibration(folders: Sequence[Path], camera: Camera, force: bool) -> bool:
    """Return whether the date folder of the drives at `folders` already has this calibration.

    Raises InputError if it has the calibration of another camera; with `force`, only if other drives share it.
    """
    date = folders[0].parent
    if not (date / _FILE).is_file():
        return False
    stored = read_calibration(date, CAMERA)
    if stored.size == camera.size and np.allclose(stored.K, camera.K, rtol=0, atol=_SAME_PX):
        return True
    drives = sorted(drive.name for drive in date.glob("*_sync") if drive not in folders)
    if force and not drives:
        return False
    raise InputError(
        f"date has the calibration of another camera, {_describe(stored)} (this one: "
        f"{_describe(camera)}; {f'used by {drives[0]}' if drives else '--force replaces it'})",
        date,
        "Pass --drive another date: all drives of a date share the calibration",
    )


def write_calibration(date: Path, camera: Camera) -> None:
    """Write calib_cam_to_cam.txt into the folder of a date."""
    entries = {
        f"S_rect_{CAMERA:02d}": np.array(camera.size[::-1], float),
        "R_rect_00": np.eye(3),
        f"P_rect_{CAMERA:02d}": np.column_stack([camera.K, np.zeros(3)]),
    }
    write_entries(date / _FILE, entries)


def _describe(camera: Camera) -> str:
    K = camera.K
    return f"{format_size(camera.size)}, focal length {K[0, 0]:.2f}, centre {K[0, 2]:.1f}, {K[1, 2]:.1f}"
