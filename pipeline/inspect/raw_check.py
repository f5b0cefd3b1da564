"""What a raw drive lacks, what of it is damaged, and what to extract: for people with half an archive."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.inspect import file_check, label_check, raw_listing
from pipeline.inspect.raw_listing import Files, gaps_between
from pipeline.inspect.words import spans
from pipeline.kitti import oxts
from pipeline.kitti.calibration import cameras_in, read_camera

HALF_EXTRACTED = 0.1  # share of missing frames from which an archive was not extracted; KITTI itself lacks single ones


@dataclass
class DriveCheck:
    """What was found of one drive: ``modalities`` as JSON, what must be done, and what is worth knowing."""

    drive: str
    folder: Path
    modalities: dict[str, dict[str, Any]] = field(default_factory=dict)
    must: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    extract: set[str] = field(default_factory=set)  # modalities that have to be extracted again
    frames: int = 0

    def advice(self) -> str:
        """Return the command that extracts what is missing; nothing if nothing is."""
        commands, root = [], self.folder.parent.parent
        parts = sorted(self.extract - {"calib"})
        if parts:
            wanted = " ".join(f"'*/{part}/*'" for part in parts)
            commands.append(f"unzip -o {self.drive}_sync.zip {wanted} -d {root}")
        if "calib" in self.extract:
            commands.append(f"unzip -o {self.drive[:10]}_calib.zip -d {root}")
        return " && ".join(commands)


def check(folder: Path, cameras: Sequence[int], lidar: bool, deep: bool) -> DriveCheck:
    """Check one drive's folder.

    Args:
        cameras: those that the project may take; the first that has images is meant to be whole.
        lidar: whether the project reads scans.
        deep: decode every file.
    """
    found = DriveCheck(folder.absolute().name.removesuffix("_sync"), folder)
    listed = {name: raw_listing.files(folder, name) for name in raw_listing.MODALITIES}
    expected = _expected(folder, listed)
    found.frames = len(listed["oxts"].sizes)
    for name, files in listed.items():
        if files.present or name == "oxts":
            _of_modality(found, name, files, expected, deep)
    _of_oxts(found, listed["oxts"])
    with_images = [camera for camera in range(4) if listed[f"image_{camera:02d}"].sizes]
    scans = bool(listed["velodyne_points"].sizes)
    _of_calibration(found, with_images, scans and lidar)
    if not with_images and not scans and not found.extract & {*raw_listing.MODALITIES} - {"oxts"}:
        found.notes.append("has neither images nor scans: labels alone can be made of it")
    elif with_images and not set(with_images) & set(cameras):
        numbers = ", ".join(map(str, with_images))
        found.must.append(f"has images of camera {numbers} alone, and ingest.cameras takes {list(cameras)}")
    return found


def _expected(folder: Path, listed: dict[str, Files]) -> list[int]:
    """Return the frames that a whole drive has: those of its packets and timestamps, or of whatever is there."""
    known = {frame for files in listed.values() for frame in files.sizes}
    if not known:
        return []
    packets, stamps = listed["oxts"].sizes, folder / "oxts" / "timestamps.txt"
    lines = len(stamps.read_bytes().split(b"\n")) - 1 if stamps.is_file() else 0
    last = max(known)
    if lines > last + 1 and lines != len(packets):  # as many as packets: a drive that was cut out of a longer one
        last = lines - 1
    return list(range(min(known) if lines <= last else 0, last + 1))


def _of_modality(found: DriveCheck, name: str, files: Files, expected: list[int], deep: bool) -> None:
    missing = [frame for frame in expected if frame not in files.sizes]
    size = _size(found.folder.parent, name)
    faults = file_check.damaged(files, size, deep)
    found.modalities[name] = {
        "files": len(files.sizes),
        "bytes": sum(files.sizes.values()),
        "missing": runs(missing),
        "damaged": dict(sorted(faults.items())),
    }
    if not files.sizes:
        found.must.append(f"{name} is empty: {'nothing was extracted' if files.present else 'its folder is missing'}")
        found.extract.add(name)
    elif missing:
        text = f"{name} lacks {len(missing)} of {len(expected)} frames: {spans(runs(missing))}"
        if len(missing) > HALF_EXTRACTED * len(expected):
            found.must.append(text)
            found.extract.add(name)
        else:
            found.notes.append(text)
    for fault, frames in file_check.by_fault(faults).items():
        more = f", and {len(frames) - 1} more: {spans(runs(frames[1:]))}" if len(frames) > 1 else ""
        found.must.append(f"{name}: frame {frames[0]} {fault}{more}")
        found.extract.add(name)
    thin = file_check.thin(files) if files.suffix == ".bin" else []
    if thin:
        found.notes.append(f"{name}: scans of less than half the usual size: {spans(runs(thin))}")


def runs(frames: list[int]) -> list[list[int]]:
    """Return [first, last] of each run of consecutive numbers in ascending `frames`."""
    if not frames:
        return []
    cuts = gaps_between(frames)
    return [
        [first, last]
        for first, last in zip(
            [frames[0], *(end + 1 for _, end in cuts)], [*(start - 1 for start, _ in cuts), frames[-1]], strict=True
        )
    ]


def _of_oxts(found: DriveCheck, files: Files) -> None:
    """Judge times and labels by the packets that are sound."""
    if not files.sizes:
        return
    times, stamps = None, files.folder.parent / "timestamps.txt"
    try:
        times = oxts.read_times(stamps, list(files.sizes))
    except InputError as error:
        found.must.append(str(error).replace(f"{stamps}", "oxts/timestamps.txt", 1))
        found.extract.add("oxts")
    sound = [row for row, frame in enumerate(files.sizes) if frame not in found.modalities["oxts"]["damaged"]]
    numbers = list(files.sizes)
    rows = np.array([oxts.read_row(files.path(numbers[row])) for row in sound]).reshape(-1, len(oxts.COLUMNS))
    found.modalities["oxts"] |= label_check.summary(rows)
    said = label_check.implausible(rows, None if times is None else times[sound])
    found.notes += [f"labels: it {why}" for why in said]


def _of_calibration(found: DriveCheck, cameras: list[int], scans: bool) -> None:
    date = found.folder.parent
    needed = ["calib_cam_to_cam.txt"] if cameras or scans else []
    needed += ["calib_velo_to_cam.txt"] if scans else []
    lacking = [name for name in needed if not (date / name).is_file()]
    try:
        for name in lacking:
            raise InputError(f"{date / name} is missing")
        for camera in cameras:
            if camera in cameras_in(date):
                read_camera(date, camera)
        if cameras and not set(cameras) & set(cameras_in(date)):
            raise InputError(f"{date}/calib_cam_to_cam.txt has none of its cameras ({cameras})")
    except (InputError, ValueError, np.linalg.LinAlgError) as error:
        found.must.append(f"calibration: {error}")
        found.extract.add("calib")


def _size(date: Path, name: str) -> tuple[int, int] | None:
    if not name.startswith("image_"):
        return None
    camera = int(name.removeprefix("image_"))
    try:
        return read_camera(date, camera).size if camera in cameras_in(date) else None
    except (InputError, ValueError, np.linalg.LinAlgError):  # _of_calibration tells it
        return None
