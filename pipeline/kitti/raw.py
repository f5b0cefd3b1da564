"""Where KITTI raw keeps a drive's files, and LiDAR scans. Everything is keyed on frame numbers, never on list position.

``<root>/<date>/<date>_drive_NNNN_sync/{image_0X,velodyne_points,oxts}/data/%010d.{png,bin,txt}``, calibration in
``<root>/<date>/``. pykitti's ``raw`` class is not used: its sorted lists shift after a missing frame.
"""

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base.errors import DamagedFile, InputError, closest
from pipeline.base.files import MiB, check_file, read_bytes
from pipeline.kitti.calibration import Camera, cameras_in, read_camera

# The lowest laser of the HDL-64E looks 24.8 degrees down and sees the road 4 m away; complete scans of KITTI reach
# below -23.6 degrees. Files list the lasers from top to bottom, so one that was cut short lacks the low ones.
_LOWEST_DEG = -20.0
_MAX_RANGE_M = 150.0  # the sensor's is 120 m
_FEWEST = 100  # points; KITTI's scans have 100,000
_MOST_BYTES = 256 * MiB
_LAST_FRAME = np.iinfo(np.int32).max  # as frame numbers are stored


class RawDrive:
    """The files of one drive; each mapping is frame number → path, in ascending order, empty where nothing is there."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.calibration = folder.parent
        self.oxts = _frames(folder / "oxts" / "data", ".txt")
        self.scans = _frames(folder / "velodyne_points" / "data", ".bin")
        # Beside KITTI's own folders, written by stage town: dense depth and classes of camera 2.
        self.truth_depth = _frames(folder / "truth" / "depth", ".png")
        self.truth_cls = _frames(folder / "truth" / "cls", ".png")

    def images(self, camera: int) -> dict[int, Path]:
        return _frames(self.folder / f"image_{camera:02d}" / "data", ".png")

    def camera(self, choices: Sequence[int]) -> Camera | None:
        """Return the first camera of `choices` that has images; without images, the first that is calibrated, or None.

        Raises InputError if the camera that has images is not calibrated.
        """
        numbers = [number for number in choices if self.images(number)]
        numbers = numbers or [number for number in choices if number in cameras_in(self.calibration)]
        return read_camera(self.calibration, numbers[0]) if numbers else None

    @property
    def oxts_times(self) -> Path:
        return self.folder / "oxts" / "timestamps.txt"

    def fingerprint(self, cameras: Sequence[int]) -> str:
        """Return a hash of the drive's names and sizes, and of the contents of its oxts and calibration.

        Contents of images and scans are left out: hashing 175 GB would take longer than ingesting it.
        """
        digest = hashlib.sha256()
        for path in self._big(cameras):
            digest.update(f"{path.relative_to(self.folder)} {path.stat().st_size}\n".encode())
        small = [*self.oxts.values(), self.oxts_times, *sorted(self.calibration.glob("calib_*.txt"))]
        for path in (path for path in small if path.is_file()):
            content = read_bytes(path, _MOST_BYTES)
            digest.update(f"{path.relative_to(self.calibration)} {len(content)}\n".encode() + content)
        return digest.hexdigest()

    def changes(self, cameras: Sequence[int]) -> str:
        """Return a hash of when the drive's images and scans were last changed: what :meth:`fingerprint` leaves out.

        It tells a file that was extracted again: unzip gives it the archive's time of modification, and its change time
        is the clock's. It says nothing of contents: a copy of the drive has another one.
        """
        stats = ((path, path.stat()) for path in self._big(cameras))
        lines = (f"{path.relative_to(self.folder)} {stat.st_mtime_ns} {stat.st_ctime_ns}\n" for path, stat in stats)
        return hashlib.sha256("".join(lines).encode()).hexdigest()

    def _big(self, cameras: Sequence[int]) -> list[Path]:
        folders = [self.scans, self.truth_depth, self.truth_cls, *(self.images(camera) for camera in cameras)]
        return [path for paths in folders for path in paths.values()]


def find_drives(root: Path, drives: Sequence[str]) -> dict[str, RawDrive]:
    """Return the named drives (as 2011_09_26_drive_0052) below `root`.

    Raises InputError if there are no drives at all, or, with close names, if one is absent.
    """
    folders = [path for path in root.glob("????_??_??/*_drive_????_sync") if path.is_dir()]
    known = sorted(path.name.removesuffix("_sync") for path in folders)
    if not known:
        raise InputError(f"{root} holds no drives: KITTI raw's layout is <date>/<date>_drive_NNNN_sync")
    for drive in drives:
        if drive not in known:
            raise InputError(f"{root} has no drive {drive}, named in ingest.drives: {closest(drive, known)}")
    return {drive: RawDrive(root / drive[:10] / f"{drive}_sync") for drive in drives}


def read_scan(path: Path) -> np.ndarray:
    """Return a scan, float32 [P,4]: x, y, z in metres in the velodyne frame, and reflectance. Raises DamagedFile."""
    from pykitti.utils import load_velo_scan  # takes a second to import

    size = check_file(path, _MOST_BYTES)
    if size == 0 or size % 16 != 0:
        raise DamagedFile(f"{path} is cut short: {size} bytes are not a whole number of points of 16 bytes")
    scan: np.ndarray = load_velo_scan(path)
    if not np.isfinite(scan).all() or np.abs(scan[:, :3]).max() > _MAX_RANGE_M:
        raise DamagedFile(f"{path} is damaged: it holds points that are not finite or beyond {_MAX_RANGE_M:.0f} m")
    none = int(np.count_nonzero(~scan[:, :3].any(axis=1)))  # KITTI's files hold returns alone
    if none or len(scan) < _FEWEST:
        raise DamagedFile(f"{path} is damaged: of its {len(scan)} points, {none} lie in the sensor itself")
    if scan[:, 3].min() < 0 or scan[:, 3].max() > 1:
        raise DamagedFile(f"{path} is damaged: it holds reflectances that are not from 0 to 1")
    lowest = np.degrees(np.arctan2(scan[:, 2], np.hypot(scan[:, 0], scan[:, 1])).min())
    if lowest > _LOWEST_DEG:
        raise DamagedFile(
            f"{path} is cut short: its {len(scan)} points reach down to {lowest:.1f} degrees of elevation, "
            f"a complete scan to less than {_LOWEST_DEG:.0f}"
        )
    return scan


def _frames(folder: Path, suffix: str) -> dict[int, Path]:
    if not folder.is_dir():
        return {}
    # Names that are not numbers are left alone: macOS adds "._0000000000.png", half-finished downloads ".part".
    names = [path for path in folder.iterdir() if path.suffix == suffix and re.fullmatch("[0-9]+", path.stem)]
    paths: dict[int, Path] = {}
    for path in sorted(names):
        number = int(path.stem) if len(path.stem) <= 10 else _LAST_FRAME + 1
        if number > _LAST_FRAME:
            raise InputError(f"{path}: KITTI numbers frames by ten digits, to {_LAST_FRAME} here: rename or remove it")
        if number in paths:
            raise InputError(f"{path} and {paths[number].name} are both frame {number}: remove the one that is wrong")
        paths[number] = path
    return dict(sorted(paths.items()))
