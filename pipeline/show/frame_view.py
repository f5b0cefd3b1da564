"""Read one frame of a drive's file, and draw it: its images beside its cloud or graph from above."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.camera.camera import read_camera
from pipeline.camera.images import to_metres
from pipeline.camera.mount import CAMERA_HEIGHT_M
from pipeline.graphs.cloud import lidar_cloud
from pipeline.graphs.graph_file import edge_pairs
from pipeline.report import figure_file, street_view
from pipeline.report.street_view import View
from pipeline.show.artefact import open_drive

# LiDAR (x forward, y left, z up) to camera (x right, y down, z forward), for drives without calibration.
_CAMERA_AXES = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], np.float64)


def read(path: Path, frame: int | None) -> tuple[View, dict[str, Any]]:
    """Read frame `frame` (None: the first) of a drive's file, and the numbers of the frame by dataset.

    Raises InputError.
    """
    if path.is_dir():
        raise InputError("expected the file of one drive, got a folder", path, f"Pass {path}/DRIVE.h5")
    with open_drive(path) as file:
        if frame is None and not len(file.frame):
            raise InputError("has no frames", path)
        number = int(file.frame[0]) if frame is None else frame
        row = file.row_of(number)
        names = [name for name in file.names if name != "frame" and file.shape(name) == file.frame.shape]
        numbers = {name: file.row(name, row).item() for name in sorted(names)}
        images = _images(file, row, numbers)
        return View(number, **images, **_points(file, row, numbers, images.get("cls"))), numbers


def _images(file: DriveReader, row: int, numbers: Mapping[str, Any]) -> dict[str, np.ndarray]:
    images = {
        name: file.row(name, row)
        for name in ("image", "depth", "depth_m", "cls")
        # In ingest, a frame may lack them; cls may be of points.
        if name in file and numbers.get(f"has_{name}", True) and len(file.shape(name)) > 2
    }
    renamed = {"image": "rgb", "depth": "depth_m"}
    return {
        renamed.get(name, name): to_metres(pixels) if name.startswith("depth") else pixels
        for name, pixels in images.items()
    }


def _points(file: DriveReader, row: int, numbers: Mapping[str, Any], cls: np.ndarray | None) -> dict[str, np.ndarray]:
    if numbers.get("has_lidar"):
        camera = read_camera(file, CAMERA_HEIGHT_M)  # a view does not use the height
        T_cam_velo = _CAMERA_AXES if camera.T_cam_velo is None else camera.T_cam_velo
        xyz, points_cls = lidar_cloud(file.rows_of("lidar", row), T_cam_velo, camera.K, cls)
        return {"xyz": xyz, "points_cls": points_cls}
    if "xyz" not in file:
        return {}
    points = {"xyz": file.rows_of("xyz", row), "points_cls": file.rows_of("cls", row)}
    if "degree" in file:
        points["edges"] = edge_pairs(file.rows_of("degree", row), file.rows_of("indices", row))
    return points


def draw(path: Path, title: str, view: View) -> None:
    """Draw a frame to a PNG file. Raises InputError if there is nothing to draw, or `path` is no file of steer."""
    if not is_drawable(view):
        raise InputError("nothing to draw, this frame has numbers only", title, "Leave out --out")
    figure_file.check_replaceable(path)
    figure_file.save(street_view.sheet(title, [view]), path)


def is_drawable(view: View) -> bool:
    """Return whether the frame has an image or points."""
    return bool(view.images()) or view.xyz is not None
