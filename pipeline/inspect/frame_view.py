"""Read one frame of a drive's file, and draw it: its images beside its cloud or graph from above."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.camera import classes
from pipeline.camera.images import to_metres
from pipeline.drawing import figure_file, street_view
from pipeline.graphs.cloud import Cloud, lidar_cloud
from pipeline.inspect.artefact import open_drive

# LiDAR (x forward, y left, z up) to camera (x right, y down, z forward), for drives without calibration.
_CAMERA_AXES = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], np.float64)


@dataclass
class FrameView:
    """One frame; what the artefact does not have is None.

    values: dataset → number; rgb uint8 [H,W,3]; depth_m [H,W], 0: invalid; cls uint8 [H,W] trainIds; cloud: xyz [P,3]
    in the camera frame, m, and trainIds [P]; edges: both ends of each edge [E,2,3], m.
    """

    frame: int
    values: dict[str, Any]
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
        numbers = [name for name in file.names if name != "frame" and file.shape(name) == file.frame.shape]
        values = {name: file.row(name, row).item() for name in sorted(numbers)}

        def image(name: str) -> np.ndarray | None:  # in ingest, a frame may lack it; cls may be of points
            present = name in file and values.get(f"has_{name}", True) and len(file.shape(name)) > 2
            return file.row(name, row) if present else None

        depth = image("depth_m") if "depth_m" in file else image("depth")
        view = FrameView(number, values, image("image"), None if depth is None else to_metres(depth), image("cls"))
        _read_points(file, row, view)
        return view


def _choose(frame: int | None, frames: np.ndarray, path: Path) -> int:
    if not len(frames):
        raise InputError("has no frames", path)
    if frame is not None and frame not in frames:
        nearest = frames[np.argmin(np.abs(frames.astype(np.int64) - frame))]
        raise InputError(f"has no frame {frame}", path, f"Frames: {frames[0]} to {frames[-1]}, nearest {nearest}")
    return int(frames[0]) if frame is None else frame


def _read_points(file: DriveReader, row: int, view: FrameView) -> None:
    if view.values.get("has_lidar"):
        calibrated = "T_cam_velo" in file
        T_cam_velo = file["T_cam_velo"] if calibrated else _CAMERA_AXES
        view.cloud = lidar_cloud(_ragged(file, "lidar", row), T_cam_velo, file["K"], view.cls)
    elif "xyz" in file:
        view.cloud = (_ragged(file, "xyz", row), _ragged(file, "cls", row))
    if "indices" in file and view.cloud:
        xyz = view.cloud[0]
        nodes = np.repeat(np.arange(len(xyz)), _ragged(file, "degree", row))
        pairs = np.stack([nodes, _ragged(file, "indices", row)], axis=1)
        view.edges = xyz[pairs[pairs[:, 0] < pairs[:, 1]]]  # each edge is stored in both directions


def _ragged(file: DriveReader, name: str, row: int) -> np.ndarray:
    start, stop = (int(end) for end in file.rows(file.pointer(name) or "ptr", row, row + 2))
    return file.rows(name, start, stop)


def draw(path: Path, title: str, view: FrameView) -> None:
    """Draw a frame to a PNG file. Raises InputError if there is nothing to draw, or for another suffix."""
    if path.suffix.lower() != ".png":
        raise InputError(f"expected a name that ends with .png, got {path}", "--out")
    if not view.drawable:
        raise InputError("nothing to draw, this frame has numbers only", title, "Leave out --out")
    depth = f"depth: {street_view.NEAR_M:g} m red to {street_view.FAR_M:g} m blue, logarithmic"
    panels = {} if view.rgb is None else {"image": view.rgb}
    panels |= {} if view.depth_m is None else {depth: street_view.colourise_depth(view.depth_m)}
    panels |= {} if view.cls is None else {"classes": classes.colourise(view.cls)}
    width = 10.0 if panels and view.cloud else 7.0
    height = max(2.6 * len(panels), 5.2 if view.cloud else 0.0) + 1.0
    figure = Figure(figsize=(width, height), layout="constrained")
    ratios = [5] * bool(panels) + [4] * (view.cloud is not None)
    grid = figure.add_gridspec(max(len(panels), 1), len(ratios), width_ratios=ratios)
    for row, (name, pixels) in enumerate(panels.items()):
        panel = figure.add_subplot(grid[row, 0])
        panel.imshow(pixels, interpolation="nearest")
        panel.set_title(name, fontsize="small", loc="left")
        panel.set_axis_off()
    labels = [] if view.cls is None else [view.cls.ravel()]
    if view.cloud is not None:
        _draw_cloud(figure.add_subplot(grid[:, -1]), *view.cloud, view.edges)
        labels.append(view.cloud[1])
    if labels:
        street_view.class_legend(figure, np.concatenate(labels), columns=6 if width < 10 else 8)
    figure.suptitle(title, fontsize="medium")
    figure_file.save(figure, path)


def _draw_cloud(panel: Axes, xyz: np.ndarray, cls: np.ndarray, edges: np.ndarray | None) -> None:
    name = f"from above: {len(xyz):,} points"
    if edges is not None:
        lines = LineCollection([*edges[..., [0, 2]]], colors="0.7", linewidths=0.5, zorder=0, rasterized=True)
        panel.add_collection(lines)
        name += f", {len(edges):,} edges"
    street_view.draw_cloud(panel, xyz, cls)
    panel.collections[-1].set(sizes=[min(12.0, max(1.0, 12_000 / max(len(xyz), 1)))])
    if (cls == classes.VOID).any():
        name += "; black: no class"
    panel.set_title(name, fontsize="small", loc="left")
