"""Draw a frame with its cloud or graph (the paper's Figures 1 and 2), and a car's path on a plane
road in an image.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pipeline.base.store import DriveReader, replacing
from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.geometry import project
from pipeline.camera.images import to_metres
from pipeline.graphs.graph_file import edge_pairs

NEAR_M, FAR_M = 4.0, 80.0  # ends of the depth scale; depth beyond them has the colour of the end
DEPTH_SCALE = ScalarMappable(LogNorm(NEAR_M, FAR_M), "turbo_r")  # red is near
LEFT_M, RIGHT_M, AHEAD_M = -22.0, 22.0, 50.0  # area shown from above
PATHS = {"predicted": (0, 200, 60), "measured": (70, 160, 255), "driven": (255, 70, 50)}  # RGB
HALF_TRACK_M, STEP_M = 0.8, 0.5  # of a path
NEAREST_M = 1.0  # drawn distance of a path from the camera
FRAMES_SHOWN = 8  # of a drive in 3D


class View(NamedTuple):
    """Data of one frame; None if it is missing."""

    frame: int  # KITTI frame number
    rgb: np.ndarray | None = None  # uint8 [H,W,3]
    depth_m: np.ndarray | None = None  # [H,W], 0 where it is invalid
    cls: np.ndarray | None = None  # trainIds [H,W]
    xyz: np.ndarray | None = None  # [P,3] in metres, camera frame
    points_cls: np.ndarray | None = None  # trainIds [P], if there are points
    edges: np.ndarray | None = None  # rows of `xyz`, [E,2], each undirected edge once
    edge_count: int = 0  # directed kNN edges after pruning, as in the paper and in all tables

    def images(self) -> dict[str, np.ndarray]:
        """Return title → pixels of image, depth (transparent where invalid) and classes (unless all
        are void).
        """
        depth = None
        if self.depth_m is not None:
            depth = np.asarray(DEPTH_SCALE.to_rgba(np.ma.masked_equal(self.depth_m, 0), bytes=True))
        cls = (
            None
            if self.cls is None or (self.cls == classes.VOID).all()
            else classes.colourise(self.cls)
        )
        images = {f"frame {self.frame}": self.rgb, "depth": depth, "classes": cls}
        return {title: pixels for title, pixels in images.items() if pixels is not None}


def read_view(number: int, *files: DriveReader) -> View:
    """Read a frame from files of any stages; a later file takes precedence. Raises InputError if a
    file lacks it.
    """
    parts: dict[str, Any] = {}
    for file in files:
        row = file.row_of(number)
        for name, key in (
            ("image", "rgb"),
            ("depth", "depth_m"),
            ("depth_m", "depth_m"),
            ("cls", "cls"),
        ):
            # In ingest, a frame may lack them; in other files, image may be of a graph, and cls of
            # points.
            present = f"has_{name}" not in file or file[f"has_{name}"][row]
            if present and name in file and file.datasets[name].ndim > 2:
                pixels = file.row(name, row)
                parts[key] = to_metres(pixels) if key == "depth_m" else pixels
        if "xyz" in file:
            parts |= {"xyz": file.rows_of("xyz", row), "points_cls": file.rows_of("cls", row)}
        if "degree" in file:
            parts["edges"] = edge_pairs(file.rows_of("degree", row), file.rows_of("indices", row))
            parts["edge_count"] = file["edges_kept"][row]
    return View(number, **parts)


def read_some(file: DriveReader) -> list[View]:
    """Read frames that are evenly spread over a drive."""
    rows = np.linspace(0, len(file.frame) - 1, min(FRAMES_SHOWN, len(file.frame))).astype(int)
    return [read_view(number, file) for number in file.frame[rows].tolist()]


def draw_image(panel: Axes, pixels: np.ndarray, title: str, **style: Any) -> None:
    """Draw pixels without axes, with a title in a `style`."""
    panel.imshow(pixels, interpolation="nearest")
    panel.set_title(title, **style)
    panel.set_axis_off()


def draw_points(panel: Axes, view: View, **style: Any) -> None:
    """Draw the points of a frame from above, in the colours of their classes, high points on
    top.
    """
    xyz, cls, edges = np.asarray(view.xyz), np.asarray(view.points_cls), view.edges
    name, count = (
        ("cloud", "") if edges is None else ("graph", f", {view.edge_count:,} directed edges")
    )
    void = "; black: no class" if (cls == classes.VOID).any() else ""
    panel.set_title(f"{name} from above: {len(xyz):,} points{count}{void}", **style)
    if edges is not None:
        lines = [*xyz[edges][..., [0, 2]]]
        panel.add_collection(LineCollection(lines, colors="0.5", linewidths=0.6, zorder=0))
    order = np.argsort(-xyz[:, 1], kind="stable")  # y points down
    size = 1.0 if edges is None else float(np.clip(4_000 / max(len(xyz), 1), 1, 12))
    colours = classes.colourise(cls[order]) / 255
    panel.scatter(xyz[order, 0], xyz[order, 2], s=size, c=colours, linewidths=0)
    panel.set(
        xlabel="x in m", ylabel="z in m", aspect="equal", xlim=(LEFT_M, RIGHT_M), ylim=(0, AHEAD_M)
    )


def class_legend(figure: Figure, view: View, columns: int) -> None:
    """Add a legend below the figure: the colours of the classes of all pixels and points."""
    parts = [np.unique(cls).tolist() for cls in (view.cls, view.points_cls) if cls is not None]
    present = sorted({number for part in parts for number in part if number < classes.COUNT})
    patches = [
        Patch(color=classes.COLOURS[number] / 255, label=classes.NAMES[number])
        for number in present
    ]
    figure.legend(
        handles=patches, loc="outside lower center", ncols=columns, fontsize="small", frameon=False
    )


def sheet(title: str, view: View) -> Figure:
    """Draw the images of a frame beside its points from above, with the depth scale and the names
    of the classes.
    """
    images, style = view.images(), {"fontsize": "small", "loc": "left"}
    figure = Figure(figsize=(10, 6), layout="constrained")
    widths = [5 if images else 0.1, 4 if view.xyz is not None else 0.1]
    left, right = figure.subfigures(1, 2, width_ratios=widths, squeeze=False).ravel()
    panels = left.subplots(len(images), 1, squeeze=False).ravel() if images else []
    for panel, (name, pixels) in zip(panels, images.items(), strict=True):
        draw_image(panel, pixels, name, **style)
    if view.depth_m is not None:
        scale = left.colorbar(DEPTH_SCALE, ax=panels, location="left", shrink=0.3, format="%d m")
        scale.set_ticks([NEAR_M, 10, 20, FAR_M])
        scale.minorticks_off()
    if view.xyz is not None:
        draw_points(right.subplots(), view, **style)
    class_legend(figure, view, columns=8)
    figure.suptitle(title)
    return figure


def save(figure: Figure, path: Path, dpi: int = 110) -> None:
    """Write `figure` to a PNG file in one step, without a version number: the same figure gives the
    same bytes.
    """
    with replacing(path) as unfinished:
        figure.savefig(
            unfinished, format="png", dpi=dpi, metadata={"Software": "semantic-steering"}
        )


def wheel_tracks(curvature_1pm: np.ndarray, camera: Camera, slope: float = 0.0) -> list[np.ndarray]:
    """Return the pixels (u, v) of the left and the right wheel's track, each [N,2], until they turn
    back.

    `curvature_1pm` [N]: of each step of STEP_M, left positive; `camera`: at its height over the
    road; `slope`: metres that the road falls per metre ahead in the camera's frame.
    """
    heading_rad = np.append(0, np.cumsum(curvature_1pm * STEP_M))
    halfway_rad = (heading_rad[1:] + heading_rad[:-1]) / 2
    middle = np.append(0, np.cumsum(STEP_M * np.exp(1j * halfway_rad)))  # ahead + left i, metres
    tracks, width = [], camera.size[1]
    for offset_m in (HALF_TRACK_M, -HALF_TRACK_M):
        wheel = middle + 1j * offset_m * np.exp(1j * heading_rad)
        down = camera.height_m + slope * wheel.real
        uv, z = project(np.stack([-wheel.imag, down, wheel.real], axis=1), camera.K)
        start = int(np.argmax(z > NEAREST_M))
        behind = np.flatnonzero(z[start:] <= NEAREST_M)  # where a path turns back
        seen = uv[start : start + behind[0] if len(behind) else None]
        tracks.append(np.clip(seen, -5 * width, 5 * width))  # OpenCV's coordinates end at 32,767
    return tracks


def path_steps(path_1pm: Sequence[float] | np.ndarray, ahead_m: Sequence[float]) -> np.ndarray:
    """Return the curvature [N] of each STEP_M of a path with mean curvature `path_1pm` [R] in
    ranges of edges [R+1].

    Before the first edge, the path has the curvature of the first range.
    """
    middles_m = np.arange(STEP_M / 2, ahead_m[-1], STEP_M)
    return np.asarray(path_1pm)[np.searchsorted(np.asarray(ahead_m)[1:-1], middles_m)]
