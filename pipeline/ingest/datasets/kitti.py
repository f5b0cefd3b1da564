"""KITTI raw: folders, LiDAR scans, calibration. Everything is keyed on frame numbers, never on list
position.

``<root>/<date>/<date>_drive_NNNN_sync/{image_0X,velodyne_points,oxts}/data/%010d.{png,bin,txt}``,
calibration in ``<root>/<date>/``; images may be JPEG. pykitti's ``raw`` class is not used: its
sorted lists shift after a missing frame, and it needs all four cameras.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import DamagedFile, InputError, closest
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.images import read_classes, read_depth, read_image
from pipeline.ingest.calibration import CALIBRATION, RENDERED, read_calibration, read_entries
from pipeline.ingest.drive import Drive, stamps
from pipeline.ingest.packets import STEERING, read_row, read_steering, read_times
from pipeline.ingest.settings import Ingest, Reading

# The lowest laser of the HDL-64E points 24.8 degrees down and hits the road 4 m away; complete
# scans of KITTI reach below -23.6 degrees. Files list the lasers from top to bottom, so a truncated
# scan lacks the low ones.
LOWEST_DEG = -20.0
_MAX_RANGE_M = 150.0  # the sensor's is 120 m
# end of the names of drives whose images are not rectified and whose scans have other times
UNSYNCED = "_extract"


def fingerprint(name: str, settings: Ingest, root: Path) -> list[Any]:
    """Return names, sizes and times of the files."""
    files = find_drive(root, name)
    return stamps(files.paths(settings.cameras), files.calibration)


def open_drive(name: str, settings: Ingest, root: Path) -> Drive:
    """Return a drive: frames with an oxts packet or, in a drive without oxts, those with an
    image.
    """
    return read_drive(find_drive(root, name), settings)


class KittiDrive:
    """The files of one drive; each mapping is frame number → path, ascending, empty if there are
    none.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.calibration = folder.parent
        self.oxts = _frames(folder / "oxts" / "data", ".txt")
        self.scans = _frames(folder / "velodyne_points" / "data", ".bin")
        self.oxts_times = folder / "oxts" / "timestamps.txt"
        # Beside KITTI's own folders, written by stage sample: dense depth and classes of camera 2.
        self.truth_depth = _frames(folder / "truth" / "depth", ".png")
        self.truth_cls = _frames(folder / "truth" / "cls", ".png")

    def images(self, camera: int) -> dict[int, Path]:
        """Return the images of a camera, as PNG or JPEG. Raises InputError if its folder has files
        but no images.
        """
        folder = self.folder / f"image_{camera:02d}" / "data"
        images = _frames(folder, ".png", ".jpg", ".jpeg")
        if names := [] if images else sorted(path.name for path in folder.glob("[!.]*")):
            problem = (
                f"has no image (got {names[0]}, expected names such as 0000000000.png or "
                "0000000000.jpg)"
            )
            raise InputError(
                problem, folder, "Extract the images again, convert them, or remove the folder"
            )
        return images

    def camera_number(self, choices: Sequence[int]) -> int | None:
        """Return the first camera of `choices` with images, else the first with a calibration, else
        None.
        """
        path, number = self.calibration / CALIBRATION, next(filter(self.images, choices), None)
        if number is None and path.is_file():
            entries = read_entries(path)
            number = next((choice for choice in choices if f"P_rect_{choice:02d}" in entries), None)
        return number

    def camera(self, number: int) -> Camera:
        """Return a calibrated camera. Raises InputError."""
        return read_calibration(self.calibration, number)

    def timeline(self, camera: int | None) -> tuple[list[int], Path]:
        """Return the numbers of the frames with an oxts packet, and the file with their times.

        A drive without packets has the frames with an image of `camera`, at the camera's times.
        """
        if camera is None or self.oxts:
            return list(self.oxts), self.oxts_times
        return list(self.images(camera)), self.folder / f"image_{camera:02d}" / "timestamps.txt"

    def paths(self, cameras: Sequence[int]) -> list[Path]:
        """Return all files that are read."""
        camera = self.camera_number(cameras)
        images = {} if camera is None else self.images(camera)
        frames = [self.oxts, self.scans, self.truth_depth, self.truth_cls, images]
        single = [
            self.timeline(camera)[1],
            *sorted(self.calibration.glob("calib_*.txt")),
            self.folder / STEERING,
        ]
        return [
            *(path for files in frames for path in files.values()),
            *filter(Path.is_file, single),
        ]


def open_folder(path: Path) -> KittiDrive:
    """Return the drive of a folder, which may be a link: its date's calibration lies beside the
    link or its target.

    Raises InputError if drives are in folders below it.
    """
    below = [
        image.parent for level in ("*", "*/*") for image in sorted(path.glob(f"{level}/image_0?"))
    ]
    if below:
        raise InputError("is a folder around drives", path, f"Pass one of them: {below[0]}")
    folder = path.absolute()
    if not (folder.parent / CALIBRATION).is_file():
        folder = path.resolve()
    return KittiDrive(folder)


def read_drive(files: KittiDrive, settings: Reading) -> Drive:
    """Return a drive, whose frames end with a DamagedFile that lists all damaged files, if there
    are any.

    Raises InputError if packets, times or the calibration are missing.
    """
    damaged, chosen = list[DamagedFile](), files.camera_number(settings.cameras)
    camera = None if chosen is None else files.camera(chosen)
    if files.scans and settings.lidar and (camera is None or camera.T_cam_velo is None):
        problem = "drive has scans, but calib_cam_to_cam.txt or calib_velo_to_cam.txt is missing"
        fix = "Extract the date's calibration archive, or set ingest.lidar: false"
        raise InputError(problem, files.calibration, fix)
    packets = ((number, _read(read_row, path, damaged)) for number, path in files.oxts.items())
    oxts = {number: row for number, row in packets if row is not None}
    numbers, times = files.timeline(chosen)
    if not numbers or (not files.oxts and files.oxts_times.parent.is_dir()):
        fix = "Extract it. Only if labels come from another labels.source: remove the empty folder"
        raise InputError("drive has no oxts packets", files.oxts_times.parent, fix)
    # Lines of timestamps.txt correspond to existing files, including damaged ones.
    all_times_s = dict(zip(numbers, read_times(times, numbers).tolist(), strict=True))
    time_s = {number: all_times_s[number] for number in oxts or numbers}
    values: dict[str, dict[int, Any]] = {"oxts": oxts} if oxts else {}
    if (steering := files.folder / STEERING).is_file():  # KITTI itself has none
        values["steering_rad"] = read_steering(steering)
    notes = [] if chosen is None else [f"camera {chosen}"]
    calibration = files.calibration / CALIBRATION
    text = calibration.read_text(errors="replace") if calibration.is_file() else ""
    images = {} if chosen is None else files.images(chosen)
    depths, classes = (files.truth_depth, files.truth_cls) if camera else ({}, {})
    scans, size = files.scans if settings.lidar else {}, camera.size if camera else None

    def frames() -> Iterator[Frame]:
        """Yield the frames, and add notes at the end."""
        faults = [*damaged]
        for number, seconds in time_s.items():
            frame = Frame(number, seconds)
            frame.scan = _read(read_scan, scans.get(number), faults)
            frame.image = _read(read_image, images.get(number), faults, size=size)
            frame.depth_m = _read(read_depth, depths.get(number), faults, size=size)
            frame.cls = _read(read_classes, classes.get(number), faults, size=size)
            yield frame
        skip, every_packet = settings.on_damaged == "skip", len(files.oxts) == len(damaged) > 0
        if faults and (every_packet or not skip):
            problem = "; ".join(f"{error.where}: {error.problem}" for error in faults)
            fix = "Extract them again" + ", or set ingest.on_damaged: skip to leave them out" * (
                not skip
            )
            where = f"{len(faults)} damaged files" + ", among them all oxts packets" * every_packet
            raise DamagedFile(problem, where, fix)
        for kind, paths in (("images", images), ("scans", scans)):
            lost = [error for error in faults if Path(error.where) in paths.values()]
            if lost and len(lost) == len(paths.keys() & time_s.keys()):  # with on_damaged: skip
                raise InputError(
                    f"all {kind} of the drive are damaged: {lost[0].problem}", lost[0].where
                )
        others = {"images or scans without a frame": len({*images, *scans} - {*numbers})}
        others["damaged files left out"] = len(faults)
        lines = [f"{count} {name}" for name, count in others.items() if count]
        notes.extend(line for line in lines if line not in notes)

    return Drive(
        camera, frames, values, notes, "sample" if text.startswith(f"{RENDERED}\n") else "kitti"
    )


def _read(
    reader: Callable[..., np.ndarray], path: Path | None, damaged: list[DamagedFile], **options: Any
) -> np.ndarray | None:
    """Return the content of a file; None if there is none, or it is damaged, which is added to
    `damaged`.
    """
    try:
        return reader(path, **options) if path else None
    except DamagedFile as error:
        damaged.append(error)
        return None


def find_drive(root: Path, name: str) -> KittiDrive:
    """Return a drive (such as 2011_09_26_drive_0052) below `root`. Raises InputError if it is
    missing.
    """
    if not root.is_dir():
        fix = (
            f"KITTI: ln -s /path/to/kitti {root}. Sample: dvc repro sample. Only training? dvc "
            "pull labels graphs"
        )
        raise InputError("folder is missing", root, fix)
    if name not in (known := _drives(root)):
        problem = f"drive {name} of ingest.drives is missing"
        if elsewhere := _elsewhere(root, name):
            raise InputError(problem, root, elsewhere)
        fix = "Extract it, or take it out of ingest.drives"
        raise InputError(f"{problem} ({closest(name, known)})", root, fix)
    return KittiDrive(root / name[:10] / f"{name}_sync")


def leave_out(root: Path, settings: Ingest, required: Collection[str] = ()) -> list[str]:
    """Return which of KITTI's drives are missing below `root`; print them, and drives that are
    there but in no split.

    Raises InputError if `root` has a drive that is rendered, or lacks all drives, all of a split,
    or one of the `required`.
    """
    known, splits, of = _drives(root), settings.drives.splits(), settings.datasets()
    if twice := next((drive for drive in known if of.get(drive) == "sample"), None):
        problem = (
            f"stage sample renders a drive of the same name, data/sample/{twice[:10]}/{twice}_sync"
        )
        fix = "Rename this folder, or set ingest.source: kitti"
        raise InputError(problem, root / twice[:10] / f"{twice}_sync", fix)
    missing = [drive for drive in splits if of[drive] == "kitti" and drive not in known]
    kept = {splits[drive] for drive in splits if drive not in missing}
    for drive in missing:
        if not known or drive in required or splits[drive] not in kept:
            find_drive(root, drive)  # raises InputError
        if elsewhere := _elsewhere(root, drive):
            print(f"left out: {drive}. {elsewhere}", flush=True)
    if missing:
        unnamed = [drive for drive in known if drive not in splits]
        hint = (
            f" (it has {', '.join(unnamed[:5])}, which ingest.drives does not name)"
            if unnamed
            else ""
        )
        print(f"left out: {root} has no {', '.join(missing)}{hint}", flush=True)
    return missing


def _elsewhere(root: Path, name: str) -> str:
    """Return what was found of a drive that is not at its place below `root`, and the way on; empty
    if nothing was.
    """
    place = f"{name[:10]}/{name}_sync"
    found = [path for start in ("", "*/", "*/*/") for path in sorted(root.glob(f"{start}{name}*"))]
    for path in found:
        if path.suffix != ".zip" and not any(path.glob("*/data")):  # a folder around the drive
            continue
        if path.stem.endswith(UNSYNCED):
            return (
                f"Found {path.relative_to(root)}: an unsynced drive. Download the synced archive, "
                f"{name}_sync.zip"
            )
        if path.suffix == ".zip":
            return f"Found {path.relative_to(root)}: extract it in {root}"
        return (
            f"Found {path.relative_to(root)}: move it to {place}, and its date's calib_*.txt to "
            f"{name[:10]}/"
        )
    return ""


def _drives(root: Path) -> list[str]:
    return sorted(
        path.name.removesuffix("_sync") for path in root.glob("????_??_??/*_drive_????_sync")
    )


def read_scan(path: Path) -> np.ndarray:
    """Return a scan, float32 [P,4]: x, y, z in metres in the velodyne frame, and reflectance in 0
    to 1.

    Rays that did not return, with a position of 0 or NaN, are left out. Raises DamagedFile;
    InputError for numbers in another format.
    """
    values = np.fromfile(path, np.float32)
    if not len(values) or len(values) % 4 or path.stat().st_size % 16:
        raise DamagedFile(
            f"scan is cut short at {path.stat().st_size} bytes (expected a multiple of 16)", path
        )
    scan = values.reshape(-1, 4)
    scan = scan[np.isfinite(scan[:, :3]).all(axis=1) & scan[:, :3].any(axis=1)]
    if (
        not len(scan)
        or np.abs(scan[:, :3]).max() > _MAX_RANGE_M
        or not np.isfinite(scan[:, 3]).all()
    ):
        raise DamagedFile(
            f"scan has no point, or points beyond {_MAX_RANGE_M:g} m or without reflectance", path
        )
    if scan[:, 3].min() < 0 or scan[:, 3].max() > 1:
        problem = f"reflectance is {scan[:, 3].min():g} to {scan[:, 3].max():g}, expected 0 to 1"
        fix = "Convert the scans: float32 x, y, z, reflectance / 255. nuScenes has five columns"
        raise InputError(problem, path, fix)
    lowest = np.degrees(np.arctan2(scan[:, 2], np.hypot(scan[:, 0], scan[:, 1])).min())
    if lowest > LOWEST_DEG:
        problem = (
            f"scan is cut short at {lowest:.1f} degrees of elevation, or of another LiDAR than "
            "the HDL-64E"
        )
        raise DamagedFile(
            f"{problem} (expected below {LOWEST_DEG:g}, LOWEST_DEG in "
            "pipeline/ingest/datasets/kitti.py)",
            path,
        )
    return scan


def _frames(folder: Path, *suffixes: str) -> dict[int, Path]:
    # Other names are ignored: macOS adds "._0000000000.png", half-finished downloads ".part". A
    # frame in two formats has the last path: that with the first suffix.
    paths = [
        path
        for path in folder.glob("*")
        if path.stem.isdecimal() and path.suffix.lower() in suffixes
    ]
    paths.sort(key=lambda path: (int(path.stem), -suffixes.index(path.suffix.lower()), path))
    return {int(path.stem): path for path in paths}
