"""One frame of an artefact: its numbers, what can be drawn of it, and its points."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.camera.classes import VOID
from pipeline.camera.geometry import transform
from pipeline.camera.images import to_metres
from pipeline.camera.pixels import read_pixels
from pipeline.graphs.cloud import Cloud, lidar_cloud
from pipeline.inspect import drive_file, file_check, raw_listing
from pipeline.inspect.apart import apart
from pipeline.kitti.calibration import read_camera
from pipeline.kitti.raw import read_scan

# From velodyne's axes (x forward, y left, z up) to the camera's (x right, y down, z forward), if nothing is calibrated.
_CAMERA_AXES = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], np.float64)


@dataclass
class FrameView:
    """What an artefact holds of one frame; what it does not hold is None.

    rgb uint8 [H,W,3]; depth_m [H,W], 0: none; cls uint8 [H,W] trainIds; cloud: xyz [P,3] in the camera frame, trainIds
    [P]; edges int [E,2] pairs of points; centres int [C] points; values: numbers of the frame, by dataset.
    """

    frame: int
    values: dict[str, Any] = field(default_factory=dict)
    rgb: np.ndarray | None = None
    depth_m: np.ndarray | None = None
    cls: np.ndarray | None = None
    cloud: Cloud | None = None
    edges: np.ndarray | None = None
    centres: np.ndarray | None = None

    @property
    def drawable(self) -> bool:
        return any(part is not None for part in (self.rgb, self.depth_m, self.cls, self.cloud))


def read(path: Path, frame: int | None) -> FrameView:
    """Read frame `frame` (None: the first) of a drive's file or of a raw drive's folder.

    Raises InputError if it has no such frame, or is neither.
    """
    if path.is_dir():
        if not raw_listing.is_drive(path):
            raise InputError(f"{path} holds several drives or none: give one drive's file, as {path}/DRIVE.h5")
        return _of_raw(path, frame)
    return apart(of_file, path, frame)


def of_file(path: Path, frame: int | None) -> FrameView:
    """Read a frame of a drive's file, as :func:`read` does, but in this process."""
    with drive_file.opened(path) as file:
        numbers = drive_file.vector(file, "frame")
        number = _chosen(frame, [int(one) for one in numbers], path)
        index = int(np.searchsorted(numbers, number))
        view = FrameView(number, _values(file, index))
        _READERS.get(str(file.attrs["stage"]), _nothing)(file, index, view)
        return view


def _chosen(frame: int | None, numbers: list[int], path: Path) -> int:
    if not numbers:
        raise InputError(f"{path} has no frames")
    if frame is None:
        return numbers[0]
    if frame not in numbers:
        near = min(numbers, key=lambda number: abs(number - frame))
        raise InputError(f"{path} has no frame {frame}: it has {numbers[0]} to {numbers[-1]}, the nearest is {near}")
    return frame


def _values(file: DriveReader, index: int) -> dict[str, Any]:
    """Return the frame's entries of all datasets that hold a number per frame."""
    count = len(file.frame)
    names = [one["name"] for one in drive_file.datasets(file) if one["shape"] == [count]]
    return {
        name: file.row(name, index).item() for name in sorted(names) if name != "frame" and not name.endswith("ptr")
    }


def _nothing(file: DriveReader, index: int, view: FrameView) -> None:
    """Labels and motion are numbers."""


def _of_ingest(file: DriveReader, index: int, view: FrameView) -> None:
    def has(what: str) -> bool:
        return f"has_{what}" in file and bool(file.row(f"has_{what}", index))

    if has("image"):
        view.rgb = drive_file.row(file, "image", index)
    if has("depth"):
        view.depth_m = to_metres(drive_file.row(file, "depth", index))
    if has("cls"):
        view.cls = drive_file.row(file, "cls", index)
    if has("lidar"):
        scan = drive_file.ragged(file, "lidar", "lidar_ptr", index)
        calibrated = "T_cam_velo" in file
        view.cloud = lidar_cloud(scan, file["T_cam_velo"] if calibrated else _CAMERA_AXES, file["K"], view.cls)


def _of_perception(file: DriveReader, index: int, view: FrameView) -> None:
    view.depth_m = to_metres(drive_file.row(file, "depth_m", index))
    view.cls = drive_file.row(file, "cls", index)


def _of_cloud(file: DriveReader, index: int, view: FrameView) -> None:
    if "image" in file:  # a variant of images
        view.rgb = drive_file.row(file, "image", index)
        return
    xyz, cls = (drive_file.ragged(file, name, "ptr", index) for name in ("xyz", "cls"))
    view.cloud = (xyz, cls)
    if "indices" in file:
        degree = drive_file.ragged(file, "degree", "ptr", index)
        neighbours = drive_file.ragged(file, "indices", "indices_ptr", index).astype(np.int64)
        view.edges = _edges(degree, neighbours, file.path)
    elif "centres_1" in file:
        view.centres = drive_file.ragged(file, "centres_1", "centres_1_ptr", index).astype(np.int64)
        if (view.centres >= len(xyz)).any():
            raise InputError(f"{file.path} is damaged: centres of row {index} are none of its points")


def _edges(degree: np.ndarray, neighbours: np.ndarray, path: Path) -> np.ndarray:
    """Return each undirected edge once, [E,2], of a frame's symmetric CSR matrix."""
    if degree.sum(dtype=np.int64) != len(neighbours) or (neighbours >= len(degree)).any():
        raise InputError(f"{path} is damaged: degrees and neighbours do not belong together")
    pairs = np.stack([np.repeat(np.arange(len(degree)), degree), neighbours], axis=1)
    return pairs[pairs[:, 0] < pairs[:, 1]]


_READERS = {"ingest": _of_ingest, "perception": _of_perception, "clouds": _of_cloud, "graphs": _of_cloud}


def _of_raw(folder: Path, frame: int | None) -> FrameView:
    cameras = [2, 0, 3, 1]
    images = {camera: raw_listing.files(folder, f"image_{camera:02d}") for camera in cameras}
    scans = raw_listing.files(folder, "velodyne_points")
    known = sorted({*scans.sizes, *(number for one in images.values() for number in one.sizes)})
    number = _chosen(frame, known, folder)
    camera = next((camera for camera in cameras if number in images[camera].sizes), None)
    view = FrameView(number)
    for files in (scans, *([images[camera]] if camera is not None else [])):
        _check_raw(files, number)
    if camera is not None:
        pixels = read_pixels(images[camera].path(number))
        view.rgb = pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=-1)
    if number in scans.sizes:
        xyz = transform(_extrinsics(folder, camera), read_scan(scans.path(number))[:, :3].astype(np.float64))
        view.cloud = (xyz.astype(np.float32), np.full(len(xyz), VOID, np.uint8))
    return view


def _check_raw(files: raw_listing.Files, number: int) -> None:
    """Raise InputError if the frame's file is damaged, or one that would be read without end."""
    alone = files._replace(sizes={frame: size for frame, size in files.sizes.items() if frame == number})
    for fault in file_check.damaged(alone, None, deep=False).values():
        raise InputError(f"{files.path(number)} {fault}. Extract it again: steer doctor says how")


def _extrinsics(folder: Path, camera: int | None) -> np.ndarray:
    """Return [4,4], velodyne to camera: of the date's calibration, or of axes alone where there is none."""
    files = (folder.parent / name for name in raw_listing.CALIBRATION[:2])
    if camera is None or not all(file.is_file() for file in files):
        return _CAMERA_AXES
    T = read_camera(folder.parent, camera).T_cam_velo
    return _CAMERA_AXES if T is None else T
