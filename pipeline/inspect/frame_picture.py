"""Draw one frame of an artefact: its images beside its cloud or graph from above."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.inspect.frame_view import FrameView
from pipeline.report import drawing, street_view


def draw(path: Path, title: str, view: FrameView) -> None:
    """Draw a frame to a PNG file. Raises InputError if there is nothing to draw, or for another suffix."""
    if path.suffix.lower() != ".png":
        raise InputError(f"expected a name that ends with .png, got {path}", "--out")
    if not view.drawable:
        raise InputError("nothing to draw, this frame has numbers only", title, "Leave out --out")
    images = {
        "image": view.rgb,
        f"depth: {street_view.NEAR_M:g} m red to {street_view.FAR_M:g} m blue, logarithmic": (
            None if view.depth_m is None else street_view.colourise_depth(view.depth_m)
        ),
        "classes": None if view.cls is None else classes.colourise(view.cls),
    }
    panels = {name: pixels for name, pixels in images.items() if pixels is not None}
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
    drawing.save(figure, path)


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
