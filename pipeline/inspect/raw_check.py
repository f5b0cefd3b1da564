"""What a raw drive lacks, what of it is damaged, and what to extract: for people with half an archive."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.inspect import file_check, label_check, raw_listing
from pipeline.inspect.phrases import spans
from pipeline.inspect.raw_listing import Files, gaps_between
from pipeline.kitti import oxts
from pipeline.kitti.calibration import cameras_in, read_camera

HALF_EXTRACTED = 0.1  # share of missing frames from which an archive was not extracted; KITTI itself lacks single ones


_MOST_CALIBRATION_BYTES = 1 << 20


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
    calibration: list[str] = field(default_factory=list)

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
    found.frames, found.calibration = len(listed["oxts"].sizes), raw_listing.calibration(folder)
    with_images = [camera for camera in cameras if listed[_images(camera)].sizes]
    wanted = {"oxts", *(_images(camera) for camera in with_images[:1] or cameras)}
    wanted |= {"velodyne_points"} if lidar else set()
    for name, files in listed.items():
        if files.present or name == "oxts":
            _of_modality(found, name, files, expected, deep, name in wanted)
    _of_oxts(found, listed["oxts"])
    scans = lidar and bool(listed["velodyne_points"].sizes)
    _of_calibration(found, with_images[:1], scans)
    others = [camera for camera in range(4) if listed[_images(camera)].sizes]
    if others and not with_images:
        found.must.append(f"has images of cameras {others} alone, and ingest.cameras takes {list(cameras)}")
    elif not others and not scans and not found.extract - {"oxts"}:
        found.notes.append("has neither images nor scans: labels alone can be made of it")
    return found


def _images(camera: int) -> str:
    return f"image_{camera:02d}"


def _expected(folder: Path, listed: dict[str, Files]) -> list[int]:
    """Return the frames that a whole drive has: those of its packets and timestamps, or of whatever is there."""
    known = {frame for files in listed.values() for frame in files.sizes}
    if not known:
        return []
    lines = raw_listing.stamps(folder, "oxts") or 0
    last = max(known)
    if lines > last + 1 and lines != len(
        listed["oxts"].sizes
    ):  # as many as packets: a drive that was cut out of a longer one
        last = lines - 1
    return list(range(min(known) if lines <= last else 0, last + 1))


def _of_modality(found: DriveCheck, name: str, files: Files, expected: list[int], deep: bool, wanted: bool) -> None:
    """Check one modality. What is wrong with one that is not `wanted` is worth knowing, no more."""
    missing = [frame for frame in expected if frame not in files.sizes]
    faults = file_check.damaged(files, _size(found.folder.parent, name), deep)
    found.modalities[name] = {
        "files": len(files.sizes),
        "bytes": sum(max(size, 0) for size in files.sizes.values()),
        "stamps": raw_listing.stamps(found.folder, name),
        "missing": runs(missing),
        "damaged": dict(sorted(faults.items())),
    }
    wrong = [f"frame {_frames(frames)} {fault}" for fault, frames in file_check.by_fault(faults).items()]
    if not files.sizes:
        wrong.append("nothing was extracted" if files.present else "its folder is missing")
    elif missing:
        text = f"lacks {len(missing)} of {len(expected)} frames: {spans(runs(missing))}"
        (wrong if len(missing) > HALF_EXTRACTED * len(expected) else found.notes).append(f"{name} {text}")
    if wanted and wrong:
        found.extract.add(name)
    if files.odd:
        wrong.append(f"{files.odd[0]} is not named as KITTI names frames ({len(files.odd)} such): rename or remove it")
    (found.must if wanted else found.notes).extend(one if one.startswith(name) else f"{name}: {one}" for one in wrong)
    thin = file_check.thin(files) if files.suffix == ".bin" else []
    if thin:
        found.notes.append(f"{name}: scans of less than half the usual size: {spans(runs(thin))}")


def _frames(frames: list[int]) -> str:
    return f"{frames[0]} (and {len(frames) - 1} more: {spans(runs(frames[1:]))})" if len(frames) > 1 else str(frames[0])


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
    found.must += [f"labels: it {why}; extract it again, or leave it out" for why in label_check.impossible(rows)]
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
        for name in needed:
            if (date / name).stat().st_size > _MOST_CALIBRATION_BYTES:
                raise InputError(f"{date / name} is no calibration file: it has {(date / name).stat().st_size} bytes")
        for camera in cameras:
            if camera in cameras_in(date):
                read_camera(date, camera)
        if cameras and not set(cameras) & set(cameras_in(date)):
            raise InputError(f"{date}/calib_cam_to_cam.txt has none of its cameras ({cameras})")
    except (InputError, ValueError, np.linalg.LinAlgError) as error:
        found.must.append(f"calibration of {date.name} cannot be used: {error}")
        found.extract.add("calib")


def _size(date: Path, name: str) -> tuple[int, int] | None:
    if not name.startswith("image_"):
        return None
    camera = int(name.removeprefix("image_"))
    try:
        return read_camera(date, camera).size if camera in cameras_in(date) else None
    except (InputError, ValueError, np.linalg.LinAlgError):  # _of_calibration tells it
        return None
