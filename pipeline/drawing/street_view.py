"""Draw the perception of a frame (the paper's Figure 2): image, depth, classes, and cloud from above."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pipeline.base.store import DriveReader
from pipeline.camera import classes
from pipeline.camera.images import to_metres

NEAR_M, FAR_M = 4.0, 80.0  # ends of the depth scale; depth beyond them has the colour of the end
LEFT_M, RIGHT_M, AHEAD_M = -22.0, 22.0, 50.0  # area shown from above


class View(NamedTuple):
    """The image of a frame with its perception."""

    frame: int  # KITTI frame number
    rgb: np.ndarray  # uint8 [H,W,3]
    depth_m: np.ndarray  # [H,W], 0 where there is none
    cls: np.ndarray  # trainIds [H,W]
    xyz: np.ndarray  # [P,3] in metres, camera frame
    points_cls: np.ndarray  # trainIds [P]


def evenly_spread(frames: np.ndarray, count: int) -> list[int]:
    """Return the middle frames of `count` equal parts of `frames` [F]; all frames if there are fewer."""
    count = min(count, len(frames))
    return [int(frames[(2 * part + 1) * len(frames) // (2 * count)]) for part in range(count)]


def read_view(raw: DriveReader, perceived: DriveReader, cloud: DriveReader, number: int) -> View:
    """Read frame `number` from the drive's files of stages ingest, perception and clouds.

    Raises InputError if one of them lacks the frame.
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
    """Return the colour scale of depth in metres, logarithmic from red (near) to blue (far)."""
    return ScalarMappable(LogNorm(NEAR_M, FAR_M), "turbo_r")


def colourise_depth(depth_m: np.ndarray) -> np.ndarray:
    """Return depth in metres [H,W] as uint8 RGBA [H,W,4]; transparent where there is none (0)."""
    return np.asarray(depth_scale().to_rgba(np.ma.masked_equal(depth_m, 0), bytes=True))


def draw_depth(panel: Axes, depth_m: np.ndarray) -> None:
    """Draw depth [H,W] in metres in the colours of :func:`depth_scale`."""
    panel.imshow(colourise_depth(depth_m), interpolation="nearest")


def draw_images(panels: Sequence[Axes], view: View, titles: Sequence[str], **style: Any) -> None:
    """Draw image, depth and classes in three panels without axes, each with a title of some `style`."""
    panels[0].imshow(view.rgb)
    draw_depth(panels[1], view.depth_m)
    panels[2].imshow(classes.colourise(view.cls), interpolation="nearest")
    for panel, title in zip(panels, titles, strict=True):
        panel.set_title(title, **style)
        panel.set_axis_off()


def draw_cloud(panel: Axes, xyz: np.ndarray, cls: np.ndarray) -> None:
    """Draw points [P,3] of the camera frame from above, in the colours of their classes [P]; high points on top."""
    order = np.argsort(-xyz[:, 1], kind="stable")  # y points down
    colours = classes.colourise(cls[order]) / 255
    panel.scatter(xyz[order, 0], xyz[order, 2], s=1, c=colours, linewidths=0, rasterized=True)
    look_from_above(panel)


def look_from_above(panel: Axes) -> None:
    """Set a panel's axes to the area ahead of the camera, in metres."""
    panel.set(xlim=(LEFT_M, RIGHT_M), ylim=(0, AHEAD_M), aspect="equal", xlabel="x in m", ylabel="z in m")


def class_legend(figure: Figure, cls: np.ndarray, columns: int) -> None:
    """Add a legend below the figure: the colours of the classes that occur in trainIds `cls` of any shape."""
    present = [number for number in np.unique(cls) if number != classes.VOID]
    patches = [Patch(color=classes.COLOURS[number] / 255, label=classes.NAMES[number]) for number in present]
    figure.legend(handles=patches, loc="outside lower center", ncols=columns, fontsize="small", frameon=False)


def sheet(title: str, views: Sequence[View]) -> Figure:
    """Draw views one below the other, with the depth scale and the names of the classes."""
    figure = Figure(figsize=(10, 1.2 + 4.9 * len(views)), layout="constrained")
    grid = figure.add_gridspec(3 * len(views), 2, width_ratios=[5, 4])
    for row, view in enumerate(views):
        left = [figure.add_subplot(grid[3 * row + i, 0]) for i in range(3)]
        draw_images(left, view, (f"frame {view.frame}", "depth", "classes"), fontsize="small", loc="left")
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
