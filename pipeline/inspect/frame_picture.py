"""A picture of one frame of an artefact: its images beside its cloud or graph from above."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.inspect.frame_view import FrameView
from pipeline.report import street_view

_DPI = 110


def draw(path: Path, title: str, view: FrameView) -> None:
    """Draw what `view` holds into a PNG file.

    Raises InputError if it holds nothing to draw, or the file's name is not that of a PNG.
    """
    if path.suffix.lower() != ".png":
        raise InputError(f"{path} is no name of a PNG file: --out NAME.png")
    if not view.drawable:
        raise InputError(f"{title}: there is nothing to draw, numbers alone: leave --out away")
    with replacing(path) as unfinished:
        _figure(title, view).savefig(unfinished, format="png", dpi=_DPI, metadata={"Software": None})


def _figure(title: str, view: FrameView) -> Figure:
    images = _images(view)
    wide, high = 10.0 if images and view.cloud else 7.0, max(2.6 * len(images), 5.2 if view.cloud else 0) + 1.0
    figure = Figure(figsize=(wide, high), layout="constrained")
    columns = [part for part in (len(images), view.cloud is not None) if part]
    grid = figure.add_gridspec(max(len(images), 1), len(columns), width_ratios=[5, 4] if len(columns) == 2 else None)
    for row, (name, paint) in enumerate(images):
        panel = figure.add_subplot(grid[row, 0])
        paint(panel)
        panel.set_title(name, fontsize="small", loc="left")
        panel.set_axis_off()
    if view.depth_m is not None:
        _depth_bar(figure)
    if view.cloud is not None:
        _draw_points(figure.add_subplot(grid[:, -1]), view)
    named = [part.ravel() for part in (view.cls, view.cloud[1] if view.cloud else None) if part is not None]
    if named and (np.concatenate(named) != classes.VOID).any():
        street_view.class_legend(figure, np.concatenate(named), columns=6 if wide < 10 else 8)
    figure.suptitle(title, fontsize="medium")
    return figure


def _images(view: FrameView) -> list[tuple[str, Callable[[Axes], object]]]:
    panels: list[tuple[str, Callable[[Axes], object]]] = []
    rgb, depth_m, cls = view.rgb, view.depth_m, view.cls
    if rgb is not None:
        panels.append(("image", lambda panel: panel.imshow(rgb)))
    if depth_m is not None:
        panels.append(("depth", lambda panel: street_view.draw_depth(panel, depth_m)))
    if cls is not None:
        panels.append(("classes", lambda panel: panel.imshow(classes.colourise(cls), interpolation="nearest")))
    return panels


def _depth_bar(figure: Figure) -> None:
    ticks = [street_view.NEAR_M, 10, 20, street_view.FAR_M]
    bar = figure.colorbar(
        street_view.depth_scale(), ax=figure.axes, location="left", shrink=0.5, format="%d m", ticks=ticks
    )
    bar.ax.tick_params(labelsize="x-small")
    bar.minorticks_off()


def _draw_points(panel: Axes, view: FrameView) -> None:
    assert view.cloud is not None
    xyz, cls = view.cloud
    name = f"from above: {len(xyz):,} points"
    if view.edges is not None:
        lines = LineCollection([*xyz[:, [0, 2]][view.edges]], colors="0.7", linewidths=0.5, zorder=0, rasterized=True)
        panel.add_collection(lines)
        name += f", {len(view.edges):,} edges"
    street_view.draw_cloud(panel, xyz, cls)
    # Few points are drawn larger.
    panel.collections[-1].set(sizes=[min(12.0, max(1.0, 12_000 / max(len(xyz), 1)))])
    if view.centres is not None:
        x, z = xyz[view.centres][:, [0, 2]].T
        panel.scatter(x, z, s=24, facecolors="none", edgecolors="black", linewidths=0.6)
        name += f", {len(view.centres):,} centres (circles)"
    if (cls == classes.VOID).any():
        name += "; black: no class"
    panel.set_title(name, fontsize="small", loc="left")
