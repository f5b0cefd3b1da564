"""Read one frame of a drive's file: numbers, images, and points."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.camera.images import to_metres
from pipeline.graphs.cloud import Cloud, lidar_cloud
from pipeline.inspect.drive_file import open_drive

# LiDAR (x forward, y left, z up) to camera (x right, y down, z forward), for drives without calibration.
_CAMERA_AXES = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], np.float64)


@dataclass
class FrameView:
    """One frame; what the artefact does not have is None.

    values: dataset → number; rgb uint8 [H,W,3]; depth_m [H,W], 0: invalid; cls uint8 [H,W] trainIds; cloud: xyz [P,3]
    in the camera frame, m, and trainIds [P]; edges: both ends of each edge [E,2,3], m.
    """

    frame: int
    values: dict[str, Any] = field(default_factory=dict)
    rgb: np.ndarray | None = None
    depth_m: np.ndarray | None = None
    cls: np.ndarray | None = None
    cloud: Cloud | None = None
    edges: np.ndarray | None = None

    @property
    def drawable(self) -> bool:
        """Whether there is an image or a cloud."""
        return any(part is not None for part in (self.rgb, self.depth_m, self.cls, self.cloud))


def read(path: Path, frame: int | None) -> FrameView:
    """Read frame `frame` (None: the first) of a drive's file. Raises InputError."""
    if path.is_dir():
        raise InputError("expected the file of one drive, got a folder", path, f"Pass {path}/DRIVE.h5")
    with open_drive(path) as file:
        number = _choose(frame, file.frame, path)
        row = int(np.searchsorted(file.frame, number))
        view = FrameView(number)
        for name in sorted({*file.names} - {"frame"}):
            if file.shape(name) == file.frame.shape:
                view.values[name] = file.row(name, row).item()
        _read_images(file, row, view)
        _read_points(file, row, view)
        return view


def _choose(frame: int | None, frames: np.ndarray, path: Path) -> int:
    if not len(frames):
        raise InputError("has no frames", path)
    if frame is not None and frame not in frames:
        nearest = frames[np.argmin(np.abs(frames.astype(np.int64) - frame))]
        raise InputError(f"has no frame {frame}", path, f"Frames: {frames[0]} to {frames[-1]}, nearest {nearest}")
    return int(frames[0]) if frame is None else frame


def _has(file: DriveReader, name: str, view: FrameView) -> bool:
    """Return whether a frame has a dataset: those of stage ingest have gaps."""
    return name in file and bool(view.values.get(f"has_{name}", True))


def _read_images(file: DriveReader, row: int, view: FrameView) -> None:
    if _has(file, "image", view):
        view.rgb = file.row("image", row)
    for name in ("depth", "depth_m"):
        if _has(file, name, view):
            view.depth_m = to_metres(file.row(name, row))
    if _has(file, "cls", view) and len(file.shape("cls")) == 3:  # not of points
        view.cls = file.row("cls", row)


def _read_points(file: DriveReader, row: int, view: FrameView) -> None:
    if _has(file, "lidar", view):
        calibrated = "T_cam_velo" in file
        T_cam_velo = file["T_cam_velo"] if calibrated else _CAMERA_AXES
        view.cloud = lidar_cloud(_ragged(file, "lidar", "lidar_ptr", row), T_cam_velo, file["K"], view.cls)
    elif "xyz" in file:
        view.cloud = (_ragged(file, "xyz", "ptr", row), _ragged(file, "cls", "ptr", row))
    if "indices" in file and view.cloud:
        xyz = view.cloud[0]
        nodes = np.repeat(np.arange(len(xyz)), _ragged(file, "degree", "ptr", row))
        pairs = np.stack([nodes, _ragged(file, "indices", "indices_ptr", row)], axis=1)
        view.edges = xyz[pairs[pairs[:, 0] < pairs[:, 1]]]  # each edge is stored in both directions


def _ragged(file: DriveReader, name: str, pointers: str, row: int) -> np.ndarray:
    start, stop = (int(end) for end in file.rows(pointers, row, row + 2))
    return file.rows(name, start, stop)
