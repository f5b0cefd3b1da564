"""Check the files of a KITTI raw drive: missing, partly extracted or damaged ones, calibration, and timestamps."""

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.executors import default_workers
from pipeline.base.files import check_file
from pipeline.camera.images import PNG_END, read_pixels
from pipeline.kitti.oxts import read_row, read_times
from pipeline.kitti.raw import RawDrive, cameras_in, read_calibration, read_scan
from pipeline.show.artefact import format_spans, gaps

_CAMERAS = range(4)
_CALIBRATION = ("cam_to_cam", "velo_to_cam", "imu_to_velo")
_DRIVE = "[0-9]*_drive_[0-9][0-9][0-9][0-9]_sync"
_PARTLY = 0.1  # share of missing frames above which an archive was partly extracted; KITTI itself lacks single frames
_MAX_PROBLEMS = 3  # of damaged files of one modality, in words
_MAX_BYTES = 1 << 28
_KITTI = "2011_"  # drives with archives; steer import and the sample have other years, and no frame is missing in them


@dataclass
class DriveCheck:
    """Result for one drive. Problems make labels or frames of the drive unusable, notes do not."""

    drive: str
    files: dict[str, int] = field(default_factory=dict)
    """Modality → number of files."""
    calibration: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    fix: str = ""
    """Command that extracts or imports again what is missing or damaged; empty if nothing is."""


def check_root(root: Path, cameras: Sequence[int], lidar: bool, deep: bool, oxts: bool = True) -> list[DriveCheck]:
    """Check one drive, or all drives below a root, as :func:`check` does. Raises InputError if there is none."""
    folders = _drives_below(root)
    if not folders:
        fix = "Expected <date>/<date>_drive_NNNN_sync in it"
        subfolders = [path for path in root.iterdir() if _drives_below(path)] if root.is_dir() else []
        raise InputError("holds no drives", root, f"Pass {subfolders[0]}" if subfolders else fix)
    with ThreadPoolExecutor(default_workers()) as pool:  # disks and decoders work in parallel
        return list(pool.map(partial(check, cameras=cameras, lidar=lidar, deep=deep, oxts=oxts), folders))


def _drives_below(root: Path) -> list[Path]:
    """Return the sorted drive folders below a KITTI raw root or a date folder; for a drive's folder, that folder."""
    if root.match(_DRIVE) or (root / "oxts" / "data").is_dir():
        return [root]
    return sorted(path for pattern in (_DRIVE, f"*/{_DRIVE}") for path in root.glob(pattern) if path.is_dir())


def check(folder: Path, cameras: Sequence[int], lidar: bool, deep: bool, oxts: bool = True) -> DriveCheck:
    """Check one drive's folder.

    Args:
        cameras: ``ingest.cameras``: the first of them that has images must be complete.
        lidar: whether scans are used.
        deep: decode every image and scan.
        oxts: whether labels need oxts; without, a drive of KITTI may lack the folder, as other drives always may.
    """
    raw, drive = RawDrive(folder), folder.absolute().name.removesuffix("_sync")
    result = DriveCheck(drive, calibration=[name for name in _CALIBRATION if _calibration_file(folder, name).is_file()])
    try:
        files = {"oxts": raw.oxts, **{_images(n): raw.images(n) for n in _CAMERAS}, "velodyne_points": raw.scans}
    except InputError as error:  # two files with one frame number
        result.problems.append(str(error))
        return result
    with_images = [camera for camera in cameras if files[_images(camera)]]
    numbers, times = raw.timeline(with_images[0] if with_images else None)
    timed = "oxts" if (oxts and drive.startswith(_KITTI)) or (folder / "oxts").is_dir() else times.parent.name
    required = {timed, *(_images(camera) for camera in with_images[:1] or cameras)}
    required |= {"velodyne_points"} if lidar else set()
    first, last = _expected_range(times, len(numbers), files, drive.startswith(_KITTI))
    damaged = set()
    for name, paths in files.items():
        if not (paths or name == timed or (folder / name).is_dir()):
            continue
        result.files[name] = len(paths)
        problems, notes = _check_frames(list(paths), first, last, (folder / name).is_dir())
        problems += _damaged_files(paths, _reader(name, deep))
        if name == timed and paths:
            problems += _input_error(read_times, times, numbers)
        if name in required and problems:
            damaged.add(name)
        (result.problems if name in required else result.notes).extend(f"{name}: {text}" for text in problems)
        result.notes += [f"{name}: {text}" for text in notes]
    scans = lidar and bool(files["velodyne_points"])
    calibration = _input_error(_check_calibration, folder.parent, with_images[:1], scans)
    result.problems += [f"calibration: {text}" for text in calibration]
    present = [camera for camera in _CAMERAS if files[_images(camera)]]
    if present and not with_images:
        result.problems.append(
            f"has images of cameras {present} only, expected one of ingest.cameras = {list(cameras)}"
        )
    elif not present and not scans and damaged <= {"oxts"}:
        result.notes.append("has neither images nor scans: only labels can be computed")
    result.fix = _fix(drive, damaged, bool(calibration), raw.calibration.absolute().parent)
    return result


def _fix(drive: str, damaged: Collection[str], calibration: bool, root: Path) -> str:
    """Return the command that mends the modalities `damaged` and the `calibration`; empty if both are complete."""
    if not drive.startswith(_KITTI):
        return f"steer import SOURCE --drive {drive} --force" if damaged or calibration else ""
    parts = " ".join(f"'*/{name}/*'" for name in sorted(damaged))
    commands = [f"unzip -o {drive}_sync.zip {parts} -d {root}"] if parts else []
    commands += [f"unzip -o {drive[:10]}_calib.zip -d {root}"] if calibration else []
    return " && ".join(commands)


def _images(camera: int) -> str:
    return f"image_{camera:02d}"


def _calibration_file(drive: Path, name: str) -> Path:
    return drive.parent / f"calib_{name}.txt"


def _input_error(function: Callable[..., object], *arguments: Any) -> list[str]:
    """Return the error that a function raises as text; empty if it raises none."""
    try:
        function(*arguments)
    except (InputError, ValueError, np.linalg.LinAlgError) as error:
        return [str(error)]
    return []


def _expected_range(stamps: Path, count: int, files: dict[str, dict[int, Path]], from_zero: bool) -> tuple[int, int]:
    """Return the first and last frame of the complete drive, from its files and the timestamps of `count` files.

    A drive that is not `from_zero` may be a part of the recording that the timestamps cover.
    """
    frames = {frame for paths in files.values() for frame in paths}
    if not frames:
        return 0, -1
    if not from_zero:
        return min(frames), max(frames)
    lines = stamps.read_bytes().rstrip(b"\n").count(b"\n") + 1 if stamps.is_file() else 0
    if lines == count or lines <= max(frames):  # may be an excerpt of a longer drive
        return (min(frames) if lines and lines <= max(frames) else 0), max(frames)
    return 0, lines - 1


def _check_frames(frames: list[int], first: int, last: int, exists: bool) -> tuple[list[str], list[str]]:
    """Return problems and notes on missing frames of one modality."""
    if not frames:
        return ["no files, archive not extracted" if exists else "folder is missing"], []
    missing = gaps(frames, first, last)
    count, expected = sum(stop - start + 1 for start, stop in missing), last - first + 1
    texts = [f"{count} of {expected} frames are missing: {format_spans(missing)}"] if missing else []
    return (texts, []) if count > _PARTLY * expected else ([], texts)


def _damaged_files(paths: dict[int, Path], read: Callable[[Path], object]) -> list[str]:
    """Return the problems of files that cannot be read, a line for each kind."""
    frames: dict[str, list[int]] = {}
    for frame, path in paths.items():
        try:
            read(path)
        except DamagedFile as error:
            problem = error.problem.replace(str(path), "").strip(": ")
            frames.setdefault(problem, []).append(frame)
        except OSError as error:
            frames.setdefault(f"cannot be read ({error.strerror})", []).append(frame)
    kinds = [f"frame {format_spans([(n, n) for n in numbers])} {problem}" for problem, numbers in frames.items()]
    more = sum(len(numbers) for numbers in [*frames.values()][_MAX_PROBLEMS:])
    return kinds[:_MAX_PROBLEMS] + ([f"{more} more files are damaged"] if more else [])


def _reader(name: str, deep: bool) -> Callable[[Path], object]:
    readers = {"oxts": read_row, "velodyne_points": read_scan if deep else _check_size}
    return readers.get(name, read_pixels if deep else _check_size)


def _check_size(path: Path) -> None:
    """Check the size of a scan or an image, and the end of an image. Raises DamagedFile."""
    size = check_file(path, _MAX_BYTES)
    with path.open("rb") as file:
        file.seek(max(0, size - len(PNG_END)))
        complete = file.read() == PNG_END if path.suffix == ".png" else size % 16 == 0
    if not size or not complete:
        raise DamagedFile("is cut short" if size else "is empty")


def _check_calibration(date: Path, cameras: Sequence[int], scans: bool) -> None:
    """Raise InputError or ValueError if the calibration of the used camera and of the LiDAR cannot be read."""
    names = (["cam_to_cam"] if cameras or scans else []) + (["velo_to_cam"] if scans else [])
    for path in (date / f"calib_{name}.txt" for name in names):
        if not path.is_file():
            raise InputError("file is missing", path)
    for camera in cameras:
        if camera not in cameras_in(date):
            raise InputError(f"has no camera {camera}", date / "calib_cam_to_cam.txt")
        read_calibration(date, camera)
