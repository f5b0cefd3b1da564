"""KITTI raw's folder layout, LiDAR scans and calibration. Everything is keyed on frame numbers, never on list position.

``<root>/<date>/<date>_drive_NNNN_sync/{image_0X,velodyne_points,oxts}/data/%010d.{png,bin,txt}``, calibration in
``<root>/<date>/``; images may be JPEG. pykitti's ``raw`` class is not used: its sorted lists shift after a missing
frame, and it needs all four cameras.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.base.errors import DamagedFile, InputError, closest, error_context
from pipeline.base.resume import digest, file_hash
from pipeline.base.store import replacing
from pipeline.camera.camera import Camera, camera_height
from pipeline.camera.geometry import rigid
from pipeline.camera.images import Size
from pipeline.kitti.oxts import STEERING

CALIBRATION = "calib_cam_to_cam.txt"  # in a date's folder
RENDERED = "dataset: sample"  # its first line, of rendered drives
HORIZON = "calib_horizon.txt"  # in the folder of an imported drive: two recordings of a camera may have two horizons
MANIFEST = "manifest.json"  # in the folder of an imported drive: the hashes of its files
# The lowest laser of the HDL-64E points 24.8 degrees down and hits the road 4 m away; complete scans of KITTI reach
# below -23.6 degrees. Files list the lasers from top to bottom, so a truncated scan lacks the low ones.
LOWEST_DEG = -20.0
_FOCAL_PER_WIDTH = 100.0  # largest plausible ratio
# Largest offsets of a principal point from the middle, as shares of width and height: of either, and of both to the
# same side, as in an image of another size. Udacity's camera has −0.08 and 0.13.
_OFF_CENTRE, _OFF_BOTH = 0.2, 0.1
_MAX_RANGE_M = 150.0  # the sensor's is 120 m


class KittiDrive:
    """The files of one drive; each mapping is frame number → path, ascending, empty if there are none."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.calibration = folder.parent
        self.oxts = _frames(folder / "oxts" / "data", ".txt")
        self.scans = _frames(folder / "velodyne_points" / "data", ".bin")
        self.oxts_times = folder / "oxts" / "timestamps.txt"
        self.steering = folder / STEERING if (folder / STEERING).is_file() else None  # KITTI itself has none
        # Beside KITTI's own folders, written by stage sample: dense depth and classes of camera 2.
        self.truth_depth = _frames(folder / "truth" / "depth", ".png")
        self.truth_cls = _frames(folder / "truth" / "cls", ".png")

    def images(self, camera: int) -> dict[int, Path]:
        """Return the images of a camera, as PNG or JPEG. Raises InputError if its folder has files but no images."""
        folder = self.folder / f"image_{camera:02d}" / "data"
        images = _frames(folder, ".png", ".jpg", ".jpeg")
        if names := [] if images else sorted(path.name for path in folder.glob("[!.]*")):
            problem = f"has no image (got {names[0]}, expected names such as 0000000000.png or 0000000000.jpg)"
            raise InputError(problem, folder, "Extract the images again, convert them, or remove the folder")
        return images

    def camera_number(self, choices: Sequence[int]) -> int | None:
        """Return the first camera of `choices` with images, else the first with a calibration, else None."""
        path, number = self.calibration / CALIBRATION, next(filter(self.images, choices), None)
        if number is None and path.is_file():
            entries = read_entries(path)
            number = next((choice for choice in choices if f"P_rect_{choice:02d}" in entries), None)
        return number

    def camera(self, number: int) -> Camera:
        """Return a calibrated camera, with the horizon's row of an imported drive. Raises InputError."""
        camera, path = read_calibration(self.calibration, number), self.folder / HORIZON
        if not path.is_file():
            return camera
        return replace(camera, horizon=float(matrix(read_entries(path), f"horizon_{number:02d}", (1,), path)[0]))

    def timeline(self, camera: int | None) -> tuple[list[int], Path]:
        """Return the numbers of the frames with an oxts packet, and the file with their times.

        A drive without packets has the frames with an image of `camera`, at the camera's times.
        """
        if camera is None or self.oxts:
            return list(self.oxts), self.oxts_times
        return list(self.images(camera)), self.folder / f"image_{camera:02d}" / "timestamps.txt"

    @property
    def dataset(self) -> str:
        """What the drive is of: sample, as its calibration says; recording, if it was imported; otherwise kitti."""
        path = self.calibration / CALIBRATION
        text = path.read_text(errors="replace") if path.is_file() else ""
        other = "recording" if (self.folder / MANIFEST).is_file() else "kitti"
        return "sample" if text.startswith(f"{RENDERED}\n") else other

    def fingerprint(self, cameras: Sequence[int]) -> str:
        """Return a hash of the names of the drive's files, and of their contents (sample) or sizes and times (others).

        Hashing the contents of KITTI's 175 GB would take longer than ingesting them. The change time detects a file
        that was extracted again: unzip restores the modification time.
        """
        dataset = self.dataset

        def content(path: Path) -> object:
            stat = path.stat()
            return file_hash(path) if dataset == "sample" else [stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns]

        camera = self.camera_number(cameras)
        images = {} if camera is None else self.images(camera)
        frames = [self.oxts, self.scans, self.truth_depth, self.truth_cls, images]
        single = [self.timeline(camera)[1], *sorted(self.calibration.glob("calib_*.txt"))]
        single += [self.folder / name for name in (STEERING, HORIZON)]
        paths = [*(path for files in frames for path in files.values()), *filter(Path.is_file, single)]
        return digest([dataset, {str(path.relative_to(self.calibration)): content(path) for path in paths}])


def find_drives(root: Path, drives: Sequence[str]) -> dict[str, KittiDrive]:
    """Return the named drives (such as 2011_09_26_drive_0052) below `root`. Raises InputError if one is missing."""
    if drives and not root.is_dir():
        fix = f"KITTI: ln -s /path/to/kitti {root}. Sample: dvc repro sample. Only training? dvc pull labels graphs"
        raise InputError("folder is missing", root, fix)
    known = _drives(root)
    for drive in drives:
        if drive not in known:
            problem = f"drive {drive} of ingest.drives is missing ({closest(drive, known)})"
            raise InputError(problem, root, "Extract it, or take it out of ingest.drives")
    return {drive: KittiDrive(root / drive[:10] / f"{drive}_sync") for drive in drives}


def leave_out(root: Path, drives: Collection[str], splits: Mapping[str, str], required: Collection[str]) -> list[str]:
    """Return which of `drives` are missing below `root`; print them, and drives that are there but in no split.

    The other drives of `splits` (drive → split) are rendered. Raises InputError if `root` has one of them, or if all
    `drives` are missing, all of a split, or one of the `required`.
    """
    known = _drives(root)
    if twice := next((drive for drive in known if drive in splits and drive not in drives), None):
        problem = f"stage sample renders a drive of the same name, data/sample/{twice[:10]}/{twice}_sync"
        fix = "Rename this folder, or set ingest.source: kitti"
        raise InputError(problem, root / twice[:10] / f"{twice}_sync", fix)
    missing = [drive for drive in drives if drive not in known]
    kept = {splits[drive] for drive in splits if drive not in missing}
    find_drives(root, [drive for drive in missing if not known or drive in required or splits[drive] not in kept])
    if missing:
        unnamed = [drive for drive in known if drive not in splits]
        hint = f" (it has {', '.join(unnamed[:5])}, which ingest.drives does not name)" if unnamed else ""
        print(f"left out: {root} has no {', '.join(missing)}{hint}", flush=True)
    return missing


def _drives(root: Path) -> list[str]:
    return sorted(path.name.removesuffix("_sync") for path in root.glob("????_??_??/*_drive_????_sync"))


def read_scan(path: Path, lowest_deg: float = LOWEST_DEG) -> np.ndarray:
    """Return a scan, float32 [P,4]: x, y, z in metres in the velodyne frame, and reflectance in 0 to 1.

    Rays that did not return, with a position of 0 or NaN, are left out. `lowest_deg`: elevation that a complete scan
    reaches. Raises DamagedFile; InputError for numbers in another format.
    """
    values = np.fromfile(path, np.float32)
    if not len(values) or len(values) % 4 or path.stat().st_size % 16:
        raise DamagedFile(f"scan is cut short at {path.stat().st_size} bytes (expected a multiple of 16)", path)
    scan = values.reshape(-1, 4)
    scan = scan[np.isfinite(scan[:, :3]).all(axis=1) & scan[:, :3].any(axis=1)]
    if not len(scan) or np.abs(scan[:, :3]).max() > _MAX_RANGE_M or not np.isfinite(scan[:, 3]).all():
        raise DamagedFile(f"scan has no point, or points beyond {_MAX_RANGE_M:g} m or without reflectance", path)
    if scan[:, 3].min() < 0 or scan[:, 3].max() > 1:
        problem = f"reflectance is {scan[:, 3].min():g} to {scan[:, 3].max():g}, expected 0 to 1"
        fix = "Convert the scans: float32 x, y, z, reflectance / 255. nuScenes has five columns"
        raise InputError(problem, path, fix)
    lowest = np.degrees(np.arctan2(scan[:, 2], np.hypot(scan[:, 0], scan[:, 1])).min())
    if lowest > lowest_deg:
        problem = f"scan is cut short: its {len(scan)} points end at {lowest:.1f} degrees of elevation"
        raise DamagedFile(f"{problem} (expected below {lowest_deg:g}, as KITTI's sensor)", path)
    return scan


def _frames(folder: Path, *suffixes: str) -> dict[int, Path]:
    # Other names are ignored: macOS adds "._0000000000.png", half-finished downloads ".part". A frame in two formats
    # has the last path: that with the first suffix.
    paths = [path for path in folder.glob("*") if path.stem.isdecimal() and path.suffix.lower() in suffixes]
    paths.sort(key=lambda path: (int(path.stem), -suffixes.index(path.suffix.lower()), path))
    return {int(path.stem): path for path in paths}


def read_calibration(folder: Path, number: int) -> Camera:
    """Read camera `number` from a date folder's files. Raises InputError for missing or wrong entries."""
    path, velo = folder / CALIBRATION, folder / "calib_velo_to_cam.txt"
    with error_context(fix="Extract the date's calibration archive (…_calib.zip) again"):
        entries = read_entries(path)
        P = matrix(entries, f"P_rect_{number:02d}", (3, 4), path)
        width, height = np.rint(matrix(entries, f"S_rect_{number:02d}", (2,), path)).astype(int).tolist()
        K, size = P[:, :3], (height, width)
        check_pinhole(K, size, f"{path}: P_rect_{number:02d}")
        if not velo.exists():
            return Camera(K, size)
        # P_rect projects from the reference camera's frame, P = K [I | t]: t shifts points to this camera. All three
        # components count: with x alone (as in pykitti) depths are off by t_z, 3 mm.
        shift = rigid(np.eye(3), np.linalg.solve(K, P[:, 3]))
        rectify = rigid(matrix(entries, "R_rect_00", (3, 3), path), np.zeros(3))
        entries = read_entries(velo)
        T_cam_velo = shift @ rectify @ rigid(matrix(entries, "R", (3, 3), velo), matrix(entries, "T", (3,), velo))
        return Camera(K, size, camera_height(T_cam_velo), T_cam_velo)


def read_entries(path: Path) -> dict[str, np.ndarray]:
    """Return name → numbers [n], read by ``pykitti.utils.read_calib_file``. Raises InputError."""
    from pykitti.utils import read_calib_file  # takes a second to import

    if not path.is_file():
        raise InputError("file is missing", path)
    try:
        return dict(read_calib_file(path))
    except ValueError as error:
        raise InputError(f"is not a calibration file ({error})", path) from error


def matrix(entries: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...], path: Path) -> np.ndarray:
    """Return entry `name` of the file at `path` in this shape. Raises InputError."""
    if name not in entries:
        raise InputError(f"has no entry {name}", path)
    values = entries[name]
    if values.size != np.prod(shape) or not np.isfinite(values).all():
        raise InputError(f"{name}: expected {np.prod(shape)} finite numbers, got {values}", path)
    return values.reshape(shape)


def check_pinhole(K: np.ndarray, size: Size, where: str) -> None:
    """Raise InputError if K [3,3] is implausible for images of `size` (H, W): focal length, centre, skew."""
    height, width = size
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    focal = min(fx, fy) > 1 and max(fx, fy) < _FOCAL_PER_WIDTH * width  # false for NaN
    pinhole = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    off = np.array([cx / width, cy / height]) - 0.5
    centred = np.abs(off).max() <= _OFF_CENTRE and not (off > _OFF_BOTH).all() and not (off < -_OFF_BOTH).all()
    if not (focal and centred and np.allclose(K, pinhole, atol=1e-3)):
        numbers = f"focal lengths {fx:g}, {fy:g} and centre {cx:g}, {cy:g}"
        guess = "" if centred else ". K is for another image size?"
        raise InputError(f"implausible intrinsics of {width} x {height} pixels: {numbers}{guess}", where)


def write_entries(path: Path, entries: Mapping[str, str | np.ndarray]) -> None:
    """Write the entries in one step: text unchanged, numbers with 13 digits."""
    with replacing(path) as tmp, tmp.open("w", encoding="ascii") as file:
        for name, value in entries.items():
            text = value if isinstance(value, str) else " ".join(f"{number:.12e}" for number in value.ravel())
            file.write(f"{name}: {text}\n")
