"""List the files of KITTI raw drives by modality."""

import re
from pathlib import Path

from pipeline.kitti.raw import RawDrive

_DRIVE = re.compile(r"\d{4}_\d\d_\d\d_drive_\d{4}_sync")
_DATE = re.compile(r"\d{4}_\d\d_\d\d")
CAMERAS = range(4)
_CALIBRATION = ("cam_to_cam", "velo_to_cam", "imu_to_velo")


def is_drive(folder: Path) -> bool:
    """Return whether a folder is a raw drive, by its name or by its content."""
    return bool(_DRIVE.fullmatch(folder.name)) or (folder / "oxts" / "data").is_dir()


def drives_below(root: Path) -> list[Path]:
    """Return the folders of the drives, sorted, below a KITTI raw root or one of its dates; of a drive, itself."""
    if is_drive(root):
        return [root]
    dates = [root] if _DATE.fullmatch(root.name) else root.iterdir() if root.is_dir() else []
    folders = (path for date in dates if _DATE.fullmatch(date.name) and date.is_dir() for path in date.iterdir())
    return sorted(path for path in folders if _DRIVE.fullmatch(path.name) and path.is_dir())


def name_of(folder: Path) -> str:
    """Return a drive's name, as 2011_09_26_drive_0052."""
    return folder.absolute().name.removesuffix("_sync")


def image_folder(camera: int) -> str:
    """Return the name of a camera's folder, as image_02."""
    return f"image_{camera:02d}"


def modalities(folder: Path) -> dict[str, dict[int, Path]]:
    """Return modality → frame number → file, ascending; empty for modalities that have no files.

    Raises InputError if two files have the same frame number.
    """
    raw = RawDrive(folder)
    images = {image_folder(camera): raw.images(camera) for camera in CAMERAS}
    return {"oxts": raw.oxts, **images, "velodyne_points": raw.scans}


def calibration(folder: Path) -> list[str]:
    """Return which calibration files a drive's date has, as cam_to_cam."""
    return [name for name in _CALIBRATION if (folder.parent / f"calib_{name}.txt").is_file()]
