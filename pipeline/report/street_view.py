"""Draw a frame with its cloud or graph (the paper's Figures 1 and 2), and a path in an image."""

from collections.abc import Mapping, Sequence
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

# Width of a picture in inches, at which its letters are readable on a screen of 400 pixels.
WIDTH = 5.0
# Pixels per inch of a picture.
DPI = 160
# Width of the line of a path in points, 3 pixels.
PATH_WIDTH = 3 * 72 / DPI
# Near end of the depth scale in metres. Smaller depths have the colour of this end.
NEAR_M = 4.0
# Far end of the depth scale in metres. Larger depths have the colour of this end.
FAR_M = 80.0
# Colours of depth: red is near.
DEPTH_SCALE = ScalarMappable(LogNorm(NEAR_M, FAR_M), "turbo_r")
# Range in metres to the right of the camera that is shown from above.
X_SHOWN_M = (-22.0, 22.0)
# Range in metres ahead of the camera that is shown from above.
Z_SHOWN_M = (0.0, 50.0)
# RGB colours of paths and curves, in images and charts.
COLOURS = {
    "driven": (255, 70, 50),
    "measured": (255, 165, 0),
    "odometry": (255, 165, 0),
    "without the scene": (70, 160, 255),
    "predicted": (0, 200, 60),
}
# Line styles of paths: offset, and lengths drawn and left out in line widths. Other lines are
# solid. A path that lies below such a line shows in its gaps.
LINE_STYLES = {
    "predicted": (0, (3.0, 2.5)),
    "without the scene": (0, (1.5, 1.0)),
    "odometry": (0, (1.0, 4.0)),
}
# Style of the box behind letters in an image.
BACKDROP = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 2.0}
# Depth of a pixel, relative to that of the path there, below which something stands in front of it.
HIDDEN_SHARE = 0.75
# Number of consecutive steps of a path, 2 m in all, that are hidden where a track ends. Fewer are
# errors of the depth, or a thing that hides no more than a gap of the track.
HIDDEN_STEPS = 4
# Half the distance in metres between the two lines of a path.
HALF_TRACK_M = 0.8
# Length in metres of the steps of a path.
STEP_M = 0.5
# Least distance in metres from the camera at which a path is drawn.
NEAREST_M = 1.0


def chart_colour(kind: str) -> tuple[float, ...]:
    """Return one of COLOURS as Matplotlib's numbers from 0 to 1."""
    return tuple(value / 255 for value in COLOURS[kind])


def path_style(kind: str) -> dict[str, Any]:
    """Return how a path is drawn, as arguments of Axes.plot."""
    return {
        "color": chart_colour(kind),
        "linewidth": PATH_WIDTH,
        "linestyle": LINE_STYLES.get(kind, "-"),
    }


class View(NamedTuple):
    """Data of one frame. A field is None if its data are missing."""

    frame: int  # KITTI frame number
    rgb: np.ndarray | None = None  # uint8 [H,W,3]
    depth_m: np.ndarray | None = None  # [H,W], 0 where it is invalid
    cls: np.ndarray | None = None  # trainIds [H,W]
    xyz: np.ndarray | None = None  # [P,3] in metres, camera frame
    points_cls: np.ndarray | None = None  # trainIds [P], if there are points
    edges: np.ndarray | None = None  # both ends of each undirected edge, rows of `xyz` [E,2]
    edge_count: int = 0  # number of directed kNN edges after pruning, as in the paper and in tables

    def images(self) -> dict[str, np.ndarray]:
        """Return title → pixels, for the image, the depth and the classes that the frame has.

        Pixels without a depth are transparent. Classes are left out if all are void.
        """
        images = {}
        if self.rgb is not None:
            images[f"frame {self.frame}"] = self.rgb
        if self.depth_m is not None:
            valid_m = np.ma.masked_equal(self.depth_m, 0)
            images[f"depth: red is {NEAR_M:g} m, blue {FAR_M:g} m"] = np.asarray(
                DEPTH_SCALE.to_rgba(valid_m, bytes=True)
            )
        if self.cls is not None and (self.cls != classes.VOID).any():
            images["classes"] = classes.colour_classes(self.cls)
        return images


def read_view(number: int, *files: DriveReader) -> View:
    """Read a frame from files of any stages; a later file takes precedence.

    Raises InputError if a file lacks the frame.
    """
    # Dataset → field of the view. Files differ in how they name depth.
    fields = {"image": "rgb", "depth": "depth_m", "depth_m": "depth_m", "cls": "cls"}
    values: dict[str, Any] = {}
    for file in files:
        row = file.row_of(number)
        for name, field in fields.items():
            # Files of clouds and graphs have datasets of these names that are no images.
            if name not in file or file.datasets[name].ndim <= 2:
                continue
            # In a file of stage ingest, a frame may lack an image.
            if f"has_{name}" in file and not file[f"has_{name}"][row]:
                continue
            pixels = file.row(name, row)
            values[field] = to_metres(pixels) if field == "depth_m" else pixels
        if "xyz" in file:
            values["xyz"] = file.rows_of("xyz", row)
            values["points_cls"] = file.rows_of("cls", row)
        if "degree" in file:
            values["edges"] = edge_pairs(file.rows_of("degree", row), file.rows_of("indices", row))
            values["edge_count"] = file["edges_kept"][row]
    return View(number, **values)


def draw_points(panel: Axes, view: View) -> None:
    """Draw the points of a frame from above in the colours of their classes, and their edges.

    High points are drawn over low ones.
    """
    xyz = np.asarray(view.xyz)
    cls = np.asarray(view.points_cls)
    title = f"cloud from above:\n{len(xyz):,} points"
    size = 1.0
    if view.edges is not None:
        title = f"graph from above:\n{len(xyz):,} points,\n{view.edge_count:,} directed edges"
        size = float(np.clip(4_000 / max(len(xyz), 1), 1, 12))
        lines = [*xyz[view.edges][..., [0, 2]]]
        panel.add_collection(LineCollection(lines, colors="0.5", linewidths=0.6, zorder=0))
    if (cls == classes.VOID).any():
        title += "; black: no class"
    panel.set_title(title, loc="left", fontsize="medium")

    low_first = np.argsort(-xyz[:, 1], kind="stable")  # y points down
    x, _, z = xyz[low_first].T
    colours = classes.colour_classes(cls[low_first]) / 255
    panel.scatter(x, z, s=size, c=colours, linewidths=0)
    panel.set(xlabel="to the right in m", ylabel="ahead in m")
    panel.set(aspect="equal", xlim=X_SHOWN_M, ylim=Z_SHOWN_M)


def draw_paths_in_image(
    panel: Axes,
    image: np.ndarray,
    camera: Camera,
    paths: Mapping[str, np.ndarray],
    depth_m: np.ndarray | None = None,
) -> None:
    """Draw the wheels' tracks of paths into an image, with a legend.

    `paths` is kind → curvature of each step. With the depth [H,W] of the image, a track ends where
    something stands in front of it.
    """
    panel.imshow(image, interpolation="bilinear")
    panel.set_axis_off()
    panel.autoscale(False)
    for kind, curvature_1pm in paths.items():
        label = kind
        for wheel in wheel_tracks(curvature_1pm, camera, depth_m=depth_m):
            panel.plot(*wheel.T, **path_style(kind), label=label)
            label = ""  # the second track is not in the legend
    panel.legend(
        loc="upper left",
        ncols=len(paths),
        fontsize="medium",
        handlelength=2,
        columnspacing=1,
        borderaxespad=0.3,
        fancybox=False,
        facecolor=BACKDROP["facecolor"],
        edgecolor=BACKDROP["edgecolor"],
        framealpha=BACKDROP["alpha"],
    )


def write_in_image(panel: Axes, text: str) -> None:
    """Write a text into the upper right corner of an image, on a backdrop."""
    panel.text(
        0.99,
        0.97,
        text,
        transform=panel.transAxes,
        horizontalalignment="right",
        verticalalignment="top",
        fontsize="medium",
        bbox=BACKDROP,
    )


def draw_paths_from_above(panel: Axes, paths: Mapping[str, np.ndarray]) -> None:
    """Draw paths over the points of :func:`draw_points`. `paths` is as in draw_paths_in_image."""
    for kind, curvature_1pm in paths.items():
        place_m, _ = path_positions(curvature_1pm)
        panel.plot(-place_m.imag, place_m.real, **path_style(kind))


def draw_sheet(title: str, view: View, graph: View | None = None) -> Figure:
    """Draw the images of a frame, and below them its points and its `graph` from above."""
    images = view.images()
    points = [part for part in (view, graph) if part is not None and part.xyz is not None]
    heights = [1.6] * len(images) + [3.6] * bool(points)
    figure = Figure(figsize=(WIDTH, sum(heights) + 0.6), layout="constrained")
    rows = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    for row, (name, pixels) in zip(rows, images.items(), strict=False):
        panel = row.subplots()
        panel.imshow(pixels, interpolation="nearest")
        panel.set_title(name, loc="left", fontsize="medium")
        panel.set_axis_off()
    if points:
        panels = rows[-1].subplots(1, len(points), squeeze=False)[0]
        for panel, part in zip(panels, points, strict=True):
            draw_points(panel, part)

    # The colours of the classes of all pixels and points are below the panels.
    present = set[int]()
    for cls in (view.cls, view.points_cls):
        if cls is not None:
            present.update(np.unique(cls).tolist())
    patches = []
    for number in sorted(present & {*range(classes.COUNT)}):
        colour = classes.COLOURS[number] / 255
        patches.append(Patch(color=colour, label=classes.NAMES[number]))
    rows[-1].legend(handles=patches, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(title, fontsize="medium")
    return figure


def save_figure(figure: Figure, path: Path, dpi: int = DPI) -> None:
    """Write `figure` to a PNG or JPEG file in one step.

    The file names no version of a program, so that the same figure gives the same bytes.
    """
    kind = path.suffix.removeprefix(".")
    options: dict[str, Any] = {"metadata": {"Software": "semantic-steering"}}
    if kind == "jpg":
        options = {"pil_kwargs": {"quality": 85}}
    with replacing(path) as unfinished:
        figure.savefig(unfinished, format=kind, dpi=dpi, **options)


def wheel_tracks(
    curvature_1pm: np.ndarray,
    camera: Camera,
    slope: float = 0.0,
    depth_m: np.ndarray | None = None,
) -> list[np.ndarray]:
    """Return the pixels (u, v) of the left and the right wheel's track, each [N,2].

    A track ends where it turns back to the camera, or where HIDDEN_STEPS of its steps lie behind
    something, before the first of them.

    Args:
        curvature_1pm: curvature [N] of each step of STEP_M, left positive.
        camera: camera at its height over the road.
        slope: metres by which the road falls per metre ahead, in the camera's frame.
        depth_m: depth of each pixel in metres [H,W], 0 where it is unknown. Without it, nothing is
            in front of a track.
    """
    middle, heading_rad = path_positions(curvature_1pm)
    tracks = []
    for offset_m in (HALF_TRACK_M, -HALF_TRACK_M):
        wheel = middle + 1j * offset_m * np.exp(1j * heading_rad)
        down_m = camera.height_m + slope * wheel.real
        uv, z = project(np.stack([-wheel.imag, down_m, wheel.real], axis=1), camera.K)

        # The track starts at its first point in front of the camera. The rest of it would be a hook
        # in the image from where it comes nearer again.
        is_shown = (z > NEAREST_M) & (np.diff(z, prepend=-np.inf) > 0)
        if depth_m is not None:
            is_shown &= ~starts_run(is_hidden(uv, z, depth_m), HIDDEN_STEPS)
        start = int(np.argmax(z > NEAREST_M))
        ends = np.flatnonzero(~is_shown[start:])
        end = start + ends[0] if len(ends) else len(uv)
        # Pixels far outside of the image are moved, since OpenCV's coordinates end at 32,767.
        limit = 5 * camera.size[1]
        tracks.append(np.clip(uv[start:end], -limit, limit))
    return tracks


def is_hidden(uv: np.ndarray, z_m: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
    """Return whether something stands in front of points, bool [N].

    The points have the pixels `uv` [N,2] and the depths `z_m` [N]. Points outside of the image,
    whose depth is `depth_m` [H,W], are not hidden.
    """
    height, width = depth_m.shape
    inside = (z_m > 0) & (uv > -0.5).all(axis=1) & (uv < [width - 0.5, height - 0.5]).all(axis=1)
    column, row = np.rint(uv[inside]).astype(int).T
    seen_m = depth_m[row, column]
    hidden = np.zeros(len(uv), bool)
    hidden[inside] = (seen_m > 0) & (seen_m < HIDDEN_SHARE * z_m[inside])
    return hidden


def starts_run(values: np.ndarray, length: int) -> np.ndarray:
    """Return whether each of `values`, bool [N], and those after it are True, `length` in all."""
    count_true = np.convolve(values, np.ones(length, int))[length - 1 :]
    return count_true == length


def path_positions(curvature_1pm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions [N+1] along a path, and the headings [N+1] in rad, left positive.

    A position is a complex number in metres, ahead + left i. `curvature_1pm` [N] is that of each
    step of STEP_M.
    """
    heading_rad = np.append(0, np.cumsum(curvature_1pm * STEP_M))
    halfway_rad = (heading_rad[1:] + heading_rad[:-1]) / 2
    position_m = np.append(0, np.cumsum(STEP_M * np.exp(1j * halfway_rad)))
    return position_m, heading_rad


def path_steps(path_1pm: Sequence[float] | np.ndarray, ahead_m: Sequence[float]) -> np.ndarray:
    """Return the curvature [N] of each step of STEP_M of a path.

    `path_1pm` [R] holds the mean curvatures in ranges with edges `ahead_m` [R+1]. Before the first
    edge, the path has the curvature of the first range.
    """
    middles_m = np.arange(STEP_M / 2, ahead_m[-1], STEP_M)
    inner_edges_m = np.asarray(ahead_m)[1:-1]
    return np.asarray(path_1pm)[np.searchsorted(inner_edges_m, middles_m)]
