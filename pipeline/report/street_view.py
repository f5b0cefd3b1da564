"""A street as the pipeline sees it (the paper's Figure 2): image, depth, classes, cloud from above."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pipeline.base.atomic import replacing
from pipeline.base.store import DriveReader
from pipeline.camera import classes
from pipeline.camera.images import to_metres

NEAR_M, FAR_M = 4.0, 80.0  # the ends of the scale of depth; what lies beyond has their colours
LEFT_M, RIGHT_M, AHEAD_M = -22.0, 22.0, 50.0  # what is shown from above


class View(NamedTuple):
    """A frame and what became of it: rgb uint8 [H,W,3], depth in metres [H,W] (0: none), trainIds [H,W], the cloud
    [P,3] in the camera frame, and the points' trainIds [P]."""

    frame: int
    rgb: np.ndarray
    depth_m: np.ndarray
    cls: np.ndarray
    xyz: np.ndarray
    points_cls: np.ndarray


def evenly_spread(frames: np.ndarray, count: int) -> list[int]:
    """Return `count` of the `frames` [F] (all, if there are fewer): the middles of as many equal parts."""
    count = min(count, len(frames))
    return [int(frames[(2 * part + 1) * len(frames) // (2 * count)]) for part in range(count)]


def read_view(raw: DriveReader, perceived: DriveReader, cloud: DriveReader, number: int) -> View:
    """Read frame `number` from its drive's files of stages ingest, perception and clouds.

    Raises InputError if one of them has no such frame.
    """
    row, points = perceived.row_of(number), cloud.row_of(number)
    start, stop = cloud.rows("ptr", points, points + 2)
    return View(
        frame=number,
        rgb=raw.row("image", raw.row_of(number)),
        depth_m=to_metres(perceived.row("depth_m", row)),
        cls=perceived.row("cls", row),
        xyz=cloud.rows("xyz", start, stop),
        points_cls=cloud.rows("cls", start, stop),
    )


def depth_scale() -> ScalarMappable:
    """Return the colour scale of depth in metres: it colours arrays, and a figure can draw its bar."""
    return ScalarMappable(LogNorm(NEAR_M, FAR_M), "turbo_r")


def colourise_depth(depth_m: np.ndarray) -> np.ndarray:
    """Return depth in metres [H,W] as uint8 RGBA [H,W,4]; where there is none (0) it is transparent black."""
    return np.asarray(depth_scale().to_rgba(np.ma.masked_equal(depth_m, 0), bytes=True))


def draw_depth(panel: Axes, depth_m: np.ndarray) -> None:
    """Draw depth [H,W] in metres: near is red, far is blue on a logarithmic scale, none is blank."""
    panel.imshow(colourise_depth(depth_m), interpolation="nearest")


def draw_cloud(panel: Axes, xyz: np.ndarray, cls: np.ndarray) -> None:
    """Draw points [P,3] of the camera frame from above, in the colours of their classes [P]; higher ones hide lower."""
    order = np.argsort(-xyz[:, 1], kind="stable")  # y points down
    colours = classes.colourise(cls[order]) / 255
    panel.scatter(xyz[order, 0], xyz[order, 2], s=1, c=colours, linewidths=0, rasterized=True)
    look_from_above(panel)


def look_from_above(panel: Axes) -> None:
    """Let a panel show the street ahead, in metres of the camera frame."""
    panel.set(xlim=(LEFT_M, RIGHT_M), ylim=(0, AHEAD_M), aspect="equal", xlabel="x in m", ylabel="z in m")


def class_legend(figure: Figure, cls: np.ndarray, columns: int) -> None:
    """Name below the figure the colours of the classes that occur in trainIds `cls` of any shape."""
    known = [number for number in np.unique(cls) if number != classes.VOID]
    patches = [Patch(color=classes.COLOURS[number] / 255, label=classes.NAMES[number]) for number in known]
    figure.legend(handles=patches, loc="outside lower center", ncols=columns, fontsize="small", frameon=False)


def sheet(title: str, views: Sequence[View]) -> Figure:
    """Draw views one below the other, with the scale of depth and the names of the classes."""
    figure = Figure(figsize=(10, 1.2 + 4.9 * len(views)), layout="constrained")
    grid = figure.add_gridspec(3 * len(views), 2, width_ratios=[5, 4])
    for row, view in enumerate(views):
        left = [figure.add_subplot(grid[3 * row + i, 0]) for i in range(3)]
        left[0].imshow(view.rgb)
        draw_depth(left[1], view.depth_m)
        left[2].imshow(classes.colourise(view.cls), interpolation="nearest")
        for panel, name in zip(left, (f"frame {view.frame}", "depth", "classes"), strict=True):
            panel.set_title(name, fontsize="small", loc="left")
            panel.set_axis_off()
        above = figure.add_subplot(grid[3 * row : 3 * row + 3, 1])
        draw_cloud(above, view.xyz, view.points_cls)
        above.set_title(f"cloud from above: {len(view.xyz):,} points", fontsize="small", loc="left")
        scale = figure.colorbar(
            depth_scale(), ax=left, location="left", shrink=0.3, format="%d m", ticks=[NEAR_M, 10, 20, FAR_M]
        )
        scale.ax.tick_params(labelsize="x-small")
        scale.minorticks_off()
    class_legend(figure, np.stack([view.cls for view in views]), columns=8)
    figure.suptitle(title)
    return figure


def draw_sheet(path: Path, title: str, views: Sequence[View]) -> None:
    """Write :func:`sheet` as a PNG file."""
    with replacing(path) as unfinished:
        sheet(title, views).savefig(unfinished, format="png", dpi=90, metadata={"Software": None})
