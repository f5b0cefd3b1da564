"""Write a drive's folder in KITTI raw's layout: images, oxts packets, calibration, and a manifest of its files."""

import json
from collections.abc import Generator, Iterable, Sequence
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from pipeline.base.errors import InputError
from pipeline.base.params import Drive
from pipeline.base.resume import file_hash
from pipeline.camera.camera import Camera
from pipeline.camera.images import format_size, write_png
from pipeline.kitti.calibration import write_entries
from pipeline.kitti.oxts import format_packet, format_times, make_rows
from pipeline.kitti.raw import HORIZON, MANIFEST, read_calibration
from pipeline.train.prefetch import side_by_side
from pipeline.video.log import MotionLog

CAMERA = 2  # left colour camera, the default of stage ingest
IMAGES = f"image_{CAMERA:02d}"
_CALIBRATION = "calib_cam_to_cam.txt"
_NOON_S = 12 * 3600.0  # time of day of the first image; nothing depends on it
_SAME_PX = 1e-6  # rounding of a calibration file's digits


def drive_folders(out: Path, drive: str, count: int, replace: bool) -> dict[str, Path]:
    """Return name → folder below `out` of `count` drives with consecutive numbers, from `drive` on.

    Raises InputError for a name that is not like KITTI's; if a drive exists, unless `replace`; and if it exists and is
    not as an earlier import wrote it.
    """
    folders = {}
    for part in range(count):
        name = f"{drive[:-4]}{int(drive[-4:]) + part:04d}" if part else drive
        try:
            TypeAdapter(Drive).validate_python(name)
        except ValidationError:
            raise InputError(f"expected names like 2027_03_31_drive_0001, got {name!r}", "--drive") from None
        folders[name] = out / name[:10] / f"{name}_sync"
        if folders[name].exists() and not replace:
            fix = "Replace it with --replace, or pass --drive another number"
            raise InputError("drive exists", folders[name], fix)
        if folders[name].exists():
            _check_unchanged(folders[name])
    return folders


def write_manifest(folder: Path, calibration: Path) -> str:
    """Write the hashes of a drive's files and of its date's calibration; return the hash of that file."""
    content = {"calibration": file_hash(calibration / _CALIBRATION), "files": _hashes(folder)}
    (folder / MANIFEST).write_text(json.dumps(content, indent=1, sort_keys=True) + "\n", encoding="ascii")
    return file_hash(folder / MANIFEST)


def _check_unchanged(folder: Path) -> None:
    """Raise InputError unless a drive's folder holds exactly the files of its manifest."""
    written = json.loads((folder / MANIFEST).read_text())["files"] if (folder / MANIFEST).is_file() else {}
    found = _hashes(folder)
    others = sorted(name for name in {*written, *found} if written.get(name) != found.get(name))
    if others:
        problem = f"{others[0]} is not as steer import wrote it ({len(others)} such files)"
        raise InputError(problem, folder, "Move the folder away, or pass --drive another number")


def _hashes(folder: Path) -> dict[str, str]:
    files = [path for path in sorted(folder.rglob("*")) if not path.is_dir() and path.name != MANIFEST]
    return {path.relative_to(folder).as_posix(): file_hash(path) for path in files}


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


def write_times(folder: Path, date: str, time_s: np.ndarray, sensors: Iterable[str]) -> None:
    """Write the times [F] in seconds of all images for each sensor's folder."""
    for sensor in sensors:
        (folder / sensor / "timestamps.txt").write_bytes(format_times(time_s - time_s[0], date, _NOON_S))


def write_packets(folder: Path, log: MotionLog, time_s: np.ndarray, usable: np.ndarray) -> None:
    """Write packets of the `usable` images, bool [F], at `time_s` [F]: speed and yaw rate; the rest is unknown, 0."""
    data = folder / "oxts" / "data"
    data.mkdir(parents=True)
    speed_mps, yaw_rate_radps = (np.interp(time_s[usable], log.time_s, x) for x in (log.speed_mps, log.yaw_rate_radps))
    rows = make_rows(len(speed_mps), vf=speed_mps, wu=yaw_rate_radps)
    for number, row in zip(np.flatnonzero(usable), rows, strict=True):
        (data / f"{number:010d}.txt").write_bytes(format_packet(row))


def check_calibration(folders: Sequence[Path], camera: Camera, replace: bool) -> bool:
    """Return whether the date folder of the drives at `folders` already has this calibration.

    Raises InputError if it has the calibration of another camera; with `replace`, only if other drives share it.
    """
    date = folders[0].parent
    if not (date / _CALIBRATION).is_file():
        return False
    stored = read_calibration(date, CAMERA)
    if stored.size == camera.size and np.allclose(stored.K, camera.K, rtol=0, atol=_SAME_PX):
        return True
    if replace and not [drive for drive in date.glob("*_sync") if drive not in folders]:
        return False
    fix = "Pass --drive another date: all drives of a date share the calibration"
    raise InputError(f"date has the calibration of another camera, {_describe(stored)}", date, fix)


def write_calibration(date: Path, camera: Camera) -> None:
    """Write calib_cam_to_cam.txt into the folder of a date."""
    entries = {
        f"S_rect_{CAMERA:02d}": np.array(camera.size[::-1], float),
        "R_rect_00": np.eye(3),
        f"P_rect_{CAMERA:02d}": np.column_stack([camera.K, np.zeros(3)]),
    }
    write_entries(date / _CALIBRATION, entries)


def write_horizon(folder: Path, row: float | None) -> None:
    """Write the row of the horizon in a drive's images, if it is known."""
    if row is not None:
        write_entries(folder / HORIZON, {f"horizon_{CAMERA:02d}": np.array([row])})


def _describe(camera: Camera) -> str:
    K = camera.K
    return f"{format_size(camera.size)}, focal length {K[0, 0]:.2f}, centre {K[0, 2]:.1f}, {K[1, 2]:.1f}"
