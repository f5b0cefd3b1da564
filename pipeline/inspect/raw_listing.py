"""What lies in a KITTI raw folder, by names and sizes alone: nothing is decoded."""

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

_DRIVE = re.compile(r"\d{4}_\d\d_\d\d_drive_\d{4}_sync")
_MOST_STAMPS_BYTES = 1 << 26  # of a timestamps.txt: two million frames
_FRAME = re.compile(r"\d{10}", re.ASCII)
_DATE = re.compile(r"\d{4}_\d\d_\d\d")
MODALITIES = {
    "oxts": ("oxts/data", ".txt"),
    **{f"image_{camera:02d}": (f"image_{camera:02d}/data", ".png") for camera in range(4)},
    "velodyne_points": ("velodyne_points/data", ".bin"),
}
"""Name → folder in a drive, suffix of its files."""
CALIBRATION = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt")


class Files(NamedTuple):
    """One modality's files: frame number → size in bytes, ascending, -1 of what is no plain file; whether its folder is
    there at all; names that are numbers, but not as KITTI writes them."""

    folder: Path
    suffix: str
    sizes: Mapping[int, int]
    present: bool
    odd: Sequence[str] = ()

    def path(self, frame: int) -> Path:
        return self.folder / f"{frame:010d}{self.suffix}"


def is_drive(folder: Path) -> bool:
    return bool(_DRIVE.fullmatch(folder.name)) or (folder / "oxts/data").is_dir()


def is_root(folder: Path) -> bool:
    """Say whether a folder is a KITTI raw root, or one of its dates."""
    return bool(drives_below(folder))


def drives_below(root: Path) -> list[Path]:
    """Return the folders of drives below a KITTI raw root, or in one of its dates, sorted."""
    dates = [root] if _DATE.fullmatch(root.name) else [path for path in _folders(root) if _DATE.fullmatch(path.name)]
    return sorted(drive for date in dates for drive in _folders(date) if _DRIVE.fullmatch(drive.name))


def _folders(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.is_dir()] if folder.is_dir() else []


def files(drive: Path, modality: str) -> Files:
    """List one modality of a drive. Names that are no numbers are left alone, as stage ingest does."""
    where, suffix = MODALITIES[modality]
    folder = drive / where
    if not folder.is_dir():
        return Files(folder, suffix, {}, folder.parent.is_dir())
    sizes, odd = {}, []
    with os.scandir(folder) as entries:
        for entry in entries:
            stem = entry.name.removesuffix(suffix)
            if _FRAME.fullmatch(stem) and stem != entry.name:
                sizes[int(stem)] = _size(entry)
            elif stem.isdigit() and stem != entry.name:
                odd.append(entry.name)
    return Files(folder, suffix, dict(sorted(sizes.items())), True, sorted(odd))


def _size(entry: "os.DirEntry[str]") -> int:
    """Return the bytes of a plain file, or of one that a link leads to; -1 of anything else."""
    try:
        return entry.stat().st_size if entry.is_file() else -1
    except OSError:  # gone just now
        return -1


def gaps_between(numbers: list[int]) -> list[list[int]]:
    """Return [first, last] of each run of numbers that is missing between ascending `numbers`."""
    steps = np.flatnonzero(np.diff(numbers) > 1)
    return [[numbers[step] + 1, numbers[step + 1] - 1] for step in steps]


def stamps(drive: Path, modality: str) -> int | None:
    """Return how many lines a modality's timestamps.txt has; None if it is absent."""
    path = drive / MODALITIES[modality][0].partition("/")[0] / "timestamps.txt"
    if not path.is_file() or path.stat().st_size > _MOST_STAMPS_BYTES:
        return None
    return path.read_bytes().rstrip(b"\n").count(b"\n") + 1


def calibration(drive: Path) -> list[str]:
    """Return which calibration files the drive's date has."""
    return [name for name in CALIBRATION if (drive.parent / name).is_file()]


def drive(folder: Path) -> dict[str, Any]:
    """Tell a raw drive: of each modality how many files, from which to which, and gaps."""
    told = {}
    for modality in MODALITIES:
        listed = files(folder, modality)
        numbers = list(listed.sizes)
        if listed.present:
            span = {"first": numbers[0], "last": numbers[-1], "gaps": gaps_between(numbers)} if numbers else {}
            counts = {"files": len(numbers), "bytes": sum(listed.sizes.values()), "stamps": stamps(folder, modality)}
            told[modality] = counts | span
    name = folder.absolute().name.removesuffix("_sync")
    return {"kind": "raw drive", "drive": name, "modalities": told, "calibration": calibration(folder)}


def root(folder: Path) -> dict[str, Any]:
    """Tell a folder of raw drives: of each drive and modality how many files."""
    counts = {
        path.name.removesuffix("_sync"): {
            name: len(listed.sizes) for name in MODALITIES if (listed := files(path, name)).present
        }
        for path in drives_below(folder)
    }
    return {"kind": "folder of raw drives", "drives": counts}
