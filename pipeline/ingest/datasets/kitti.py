"""Read the drives of KITTI raw: images, LiDAR scans, oxts packets and calibration.

All data of a frame is found by the frame's number, never by a position in a list. The files of a
drive are
``<root>/<date>/<date>_drive_NNNN_sync/{image_0X,velodyne_points,oxts}/data/%010d.{png,bin,txt}``.
Images may also be JPEG files. The calibration is in ``<root>/<date>/``. `steer import` writes
drives of this layout with another name in place of the date. pykitti's ``raw`` class is not used:
its sorted lists shift after a missing frame, and it needs all four cameras.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.images import read_classes, read_depth, read_image
from pipeline.ingest.calibration import CALIBRATION, RENDERED, read_calibration
from pipeline.ingest.clocks import compare_times
from pipeline.ingest.drive import Drive, list_file_facts
from pipeline.ingest.packets import VALUE_FILES, read_packet, read_times, read_values
from pipeline.ingest.settings import Ingest, Reading

# Elevation in degrees below which a complete scan has points. The lowest laser of the HDL-64E is
# directed 24.8 degrees down and hits the road 4 m away; complete scans of KITTI reach below -23.6
# degrees. Files list the lasers from top to bottom, so a truncated scan lacks the low ones.
LOWEST_DEG = -20.0
# Largest coordinate in metres of a point. The range of the sensor is 120 m.
_MAX_RANGE_M = 150.0
# File that `steer import` writes beside the calibration of its drives.
IMPORT = "import.json"
# Suffix of the folders of unsynced drives. Their images are not rectified, and their scans are not
# taken at the times of the images.
UNSYNCED = "_extract"


def fingerprint(name: str, settings: Ingest, root: Path) -> list[Any]:
    """Return the names, sizes and times of a drive's files."""
    files = find_drive(root, name)
    return list_file_facts(files.list_files(), files.calibration)


def open_drive(name: str, settings: Ingest, root: Path) -> Drive:
    """Return a drive.

    Its frames are those with an oxts packet or, if the drive has no packets, those with an image.
    """
    return read_drive(find_drive(root, name), settings)


class KittiDrive:
    """The files of one drive; each mapping is frame number → path, ascending."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.calibration = folder.parent
        self.oxts = _list_frames(folder / "oxts" / "data", ".txt")
        self.scans = _list_frames(folder / "velodyne_points" / "data", ".bin")
        self.oxts_times = folder / "oxts" / "timestamps.txt"
        # KITTI itself lacks these folders. Stage sample writes them: dense depth and classes of
        # camera 2.
        self.truth_depth = _list_frames(folder / "truth" / "depth", ".png")
        self.truth_cls = _list_frames(folder / "truth" / "cls", ".png")

    def find_images(self, camera: int) -> dict[int, Path]:
        """Return the images of a camera, as PNG or JPEG.

        Raises InputError if its folder has files but no images.
        """
        folder = self.folder / f"image_{camera:02d}" / "data"
        images = _list_frames(folder, ".png", ".jpg", ".jpeg")
        names = sorted(path.name for path in folder.glob("[!.]*"))
        if names and not images:
            raise InputError(
                f"has no image (got {names[0]}, expected names such as 0000000000.png or "
                "0000000000.jpg)",
                folder,
                "Extract the images again, convert them, or remove the folder",
            )
        return images

    def choose_camera(self, choices: Sequence[int]) -> int:
        """Return the first camera of `choices` with images, or the first if none has images."""
        for number in choices:
            if self.find_images(number):
                return number
        return choices[0]

    def read_camera(self, number: int) -> Camera:
        """Return a calibrated camera. Raises InputError."""
        return read_calibration(self.calibration, number)

    def is_rendered(self) -> bool:
        """Return whether stage sample rendered the drive, as its calibration says."""
        text = (self.calibration / CALIBRATION).read_text(errors="replace")
        return text.startswith(f"{RENDERED}\n")

    def find_logs(self) -> list[Path]:
        """Return the files with values of logs."""
        paths = [self.folder / name for name in VALUE_FILES]
        return [path for path in paths if path.is_file()]

    def count_recordings(self) -> int:
        """Return the number of files from which the drive was imported; 1 for other drives."""
        path = self.calibration / IMPORT
        if not path.is_file():
            return 1
        try:
            return len(json.loads(path.read_text(encoding="utf-8"))["recordings"])
        except (LookupError, TypeError, ValueError) as error:
            fix = "Import the recording again: steer import"
            raise InputError(f"not the record of an import ({error!r})", path, fix) from error

    def image_times(self, camera: int) -> Path:
        """Return the file with the times of a camera's images, which may be missing."""
        return self.folder / f"image_{camera:02d}" / "timestamps.txt"

    def list_files(self) -> list[Path]:
        """Return all files of the drive and of its calibration."""
        paths = [*self.calibration.glob("calib_*.txt"), *self.calibration.glob(IMPORT)]
        for folder, _, names in os.walk(self.folder, followlinks=True):
            paths += [Path(folder, name) for name in names if not name.startswith(".")]
        return sorted(paths)


def open_folder(path: Path) -> KittiDrive:
    """Return the drive of a folder, which may be a link.

    The calibration is in the folder around the link, or in the folder around its target. Raises
    InputError if `path` is itself a folder around drives.
    """
    below = sorted(path.glob("*/image_0?")) + sorted(path.glob("*/*/image_0?"))
    if below:
        fix = f"Pass one of them: {below[0].parent}"
        raise InputError("is a folder around drives", path, fix)
    folder = path.absolute()
    if not (folder.parent / CALIBRATION).is_file():
        folder = path.resolve()
    return KittiDrive(folder)


def read_drive(files: KittiDrive, settings: Reading) -> Drive:
    """Return a drive, whose frames are read only when they are iterated over.

    Raises InputError if packets, times or the calibration are missing, if all packets are damaged
    and ``ingest.on_damaged`` is skip, or if the times of packets and images do not fit.
    """
    camera_number = files.choose_camera(settings.cameras)
    camera = files.read_camera(camera_number)
    images = files.find_images(camera_number)
    notes = []
    if camera_number != settings.cameras[0]:
        notes.append(f"camera {camera_number}, as camera {settings.cameras[0]} has no images")
    if files.scans and settings.lidar and camera.T_cam_velo is None:
        problem = "drive has scans, but calib_velo_to_cam.txt is missing"
        fix = "Extract the date's calibration archive, or set ingest.lidar: false"
        raise InputError(problem, files.calibration, fix)

    damaged = list[DamagedFile]()
    oxts = {}
    for number, path in files.oxts.items():
        try:
            oxts[number] = read_packet(path)
        except DamagedFile as fault:
            damaged.append(fault)
    if damaged and not oxts and settings.on_damaged == "skip":
        problem = f"all packets of the drive are damaged: {damaged[0].problem}"
        raise InputError(problem, damaged[0].where)
    # A frame whose packet is damaged is left out.
    all_times_s = _read_timeline(files, camera_number)
    time_s = {number: all_times_s[number] for number in oxts or all_times_s}

    values: dict[str, dict[int, Any]] = {}
    if oxts:
        values["oxts"] = oxts
    # Logs replace what packets say.
    for path in files.find_logs():
        values |= read_values(path)
    scans = files.scans if settings.lidar else {}
    without_frame = {*images, *scans} - {*all_times_s}
    if without_frame:
        notes.append(f"{len(without_frame)} images or scans without a frame")
    if oxts and images:
        times = files.image_times(camera_number)
        if times.is_file():
            notes += compare_times(files.oxts_times, list(all_times_s), times, list(images))
        # Times do not show it if images were deleted and renumbered, and their times were not. The
        # sample's packets go on after the last image.
        last = max(images)
        is_complete = len(images) == last + 1
        if is_complete and max(files.oxts) > last and not files.is_rendered():
            notes.append(
                f"images end at frame {last}, packets at {max(files.oxts)}: if images were "
                "renumbered, labels are wrong"
            )

    def frames() -> Iterator[Frame]:
        for number, seconds in time_s.items():
            frame = Frame(number, seconds)
            frame.scan = _bind_reader(read_scan, scans.get(number))
            frame.image = _bind_reader(read_image, images.get(number), size=camera.size)
            frame.depth_m = _bind_reader(
                read_depth, files.truth_depth.get(number), size=camera.size
            )
            frame.cls = _bind_reader(read_classes, files.truth_cls.get(number), size=camera.size)
            yield frame

    dataset = "sample" if files.is_rendered() else "kitti"
    return Drive(
        camera,
        frames,
        values=values,
        notes=notes,
        dataset=dataset,
        recordings=files.count_recordings(),
        damaged=damaged,
    )


def _read_timeline(files: KittiDrive, camera: int) -> dict[int, float]:
    """Return frame number → time in seconds of all frames, also of those with damaged files."""
    numbers = list(files.oxts)
    times = files.oxts_times
    if not numbers:
        # Without packets, the frames are those with an image.
        numbers = list(files.find_images(camera))
        times = files.image_times(camera)
    folder = files.oxts_times.parent
    # A folder without packets is taken for an incomplete extraction.
    if not numbers or (not files.oxts and folder.is_dir()):
        fix = "Extract it. Only with labels.source: motion, remove the empty folder"
        raise InputError("drive has no oxts packets", folder, fix)
    return dict(zip(numbers, read_times(times, numbers).tolist(), strict=True))


def _bind_reader(
    read: Callable[..., np.ndarray], path: Path | None, **options: Any
) -> Callable[[], np.ndarray] | None:
    """Return a function that reads a file, or None if `path` is None."""
    return partial(read, path, **options) if path else None


def find_drive(root: Path, name: str) -> KittiDrive:
    """Return a drive (such as 2011_09_26_drive_0052) below `root`.

    Raises InputError if it is missing.
    """
    check_drives(root, [name])
    return KittiDrive(_drive_folder(root, name))


def check_drives(root: Path, names: Iterable[str]) -> None:
    """Raise InputError if drives are missing below `root`."""
    missing = [name for name in names if not _drive_folder(root, name).is_dir()]
    if not missing:
        return
    first, *others = missing
    problem = "drive is missing"
    if others:
        problem += f", and so are {', '.join(others)}"
    fix = (
        "Extract or import it, or take it out of ingest.drives. KITTI: ln -s /path/to/kitti "
        f"{root}. Sample: dvc repro sample. Only training? dvc pull graphs motion labels"
    )
    raise InputError(problem, _drive_folder(root, first), fix)


def _drive_folder(root: Path, name: str) -> Path:
    """Return the folder of drive NAME_drive_0001, which is in folder NAME with its calibration."""
    return root / name.rpartition("_drive_")[0] / f"{name}_sync"


def read_scan(path: Path) -> np.ndarray:
    """Return a scan, float32 [P,4]: x, y, z in metres in the velodyne frame, and reflectance.

    Reflectance is 0 to 1. Rays that did not return have a position of 0 or NaN, and are left out.
    Raises DamagedFile for a scan that is cut short or implausible, and InputError for reflectance
    of another range.
    """
    size = path.stat().st_size
    values = np.fromfile(path, np.float32)
    if not len(values) or size % 16:
        raise DamagedFile(f"scan is cut short at {size} bytes (expected a multiple of 16)", path)
    rays = values.reshape(-1, 4)
    returned = np.isfinite(rays[:, :3]).all(axis=1) & rays[:, :3].any(axis=1)
    scan = rays[returned]

    x, y, z, reflectance = scan.T
    far = np.abs(scan[:, :3]).max(initial=0) > _MAX_RANGE_M
    if not len(scan) or far or not np.isfinite(reflectance).all():
        raise DamagedFile(
            f"scan has no point, or points beyond {_MAX_RANGE_M:g} m or without reflectance", path
        )
    if reflectance.min() < 0 or reflectance.max() > 1:
        problem = f"reflectance is {reflectance.min():g} to {reflectance.max():g}, expected 0 to 1"
        fix = "Convert the scans: float32 x, y, z, reflectance / 255. nuScenes has five columns"
        raise InputError(problem, path, fix)
    lowest_deg = np.degrees(np.arctan2(z, np.hypot(x, y)).min())
    if lowest_deg > LOWEST_DEG:
        raise DamagedFile(
            f"scan is cut short at {lowest_deg:.1f} degrees of elevation, or of another LiDAR than "
            f"the HDL-64E (expected below {LOWEST_DEG:g}, LOWEST_DEG in "
            "pipeline/ingest/datasets/kitti.py)",
            path,
        )
    return scan


def _list_frames(folder: Path, *suffixes: str) -> dict[int, Path]:
    """Return frame number → file in a folder, ascending.

    If a frame has files in two formats, its file is that with the first of the `suffixes`.
    """
    # Other names are ignored: macOS adds "._0000000000.png", half-finished downloads ".part".
    paths = [
        path
        for path in folder.glob("*")
        if path.stem.isdecimal() and path.suffix.lower() in suffixes
    ]
    # Of several paths of a frame, the dict keeps the last: so the first suffix is sorted last.
    paths.sort(key=lambda path: (int(path.stem), -suffixes.index(path.suffix.lower()), path))
    return {int(path.stem): path for path in paths}
