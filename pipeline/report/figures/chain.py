"""Draw the way of one frame from image to steering angle (Figure 1), and semantic pruning (Figure 3)."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pipeline.camera import classes
from pipeline.graphs import graph
from pipeline.report.drawing import save_png_and_svg
from pipeline.report.street_view import View, class_legend, draw_cloud, draw_depth, look_from_above

CHAIN_POINTS, PRUNING_POINTS = 300, 100


def draw_chain(path: Path, view: View, steering: pd.DataFrame, k: int, keep_inter_class: float) -> None:
    """Draw image, depth, classes, cloud, pruned graph, and steering over the drive of `view`.

    `steering` has one model's predictions for the drive; `k` and `keep_inter_class` are those of its graph variant.
    """
    figure = Figure(figsize=(13, 6.4), layout="constrained")
    panels = figure.subplot_mosaic("aabbcc;ddeeff", height_ratios=[1, 2.2])
    panels["a"].imshow(view.rgb)
    draw_depth(panels["b"], view.depth_m)
    panels["c"].imshow(classes.colourise(view.cls), interpolation="nearest")
    for key, title in zip("abc", ("image", "depth from the image", "classes from the image"), strict=True):
        panels[key].set_title(title)
        panels[key].set_axis_off()
    draw_cloud(panels["d"], view.xyz, view.points_cls)
    panels["d"].set_title(f"cloud from above: {len(view.xyz):,} points")
    rows = _sample(len(view.xyz), CHAIN_POINTS)
    xyz, cls = view.xyz[rows], view.points_cls[rows]
    pruned = graph.build(xyz, cls, k, keep_inter_class, np.random.default_rng(0))
    _draw_graph(panels["e"], xyz, cls, pruned)
    look_from_above(panels["e"])
    panels["e"].set_title(f"graph of {len(rows)} points: {pruned.edges_knn:,} edges, pruned to {pruned.edges_kept:,}")
    _draw_steering(panels["f"], steering, view.frame)
    class_legend(figure, np.concatenate([view.cls.ravel(), view.points_cls]), columns=10)
    save_png_and_svg(figure, path)


def _draw_steering(panel: Axes, steering: pd.DataFrame, frame: int) -> None:
    time_s = steering["elapsed_s"]
    panel.plot(time_s, steering["driven_deg"], color="0.15", linewidth=2.5, label="driven")
    panel.plot(time_s, steering["odometry_deg"], color="tab:orange", linestyle="--", label="odometry")
    panel.plot(time_s, steering["predicted_deg"], color="tab:blue", label="predicted")
    panel.axvline(time_s[steering["frame"] == frame].iloc[0], color="0.7", linewidth=1)
    panel.set(xlabel="time in s", title="steering in deg, left +; grey: this frame")
    panel.margins(x=0)
    panel.legend(frameon=False)


def draw_pruning(path: Path, title: str, xyz: np.ndarray, cls: np.ndarray, k: int, keep_inter_class: float) -> None:
    """Draw the kNN graph of a cloud xyz [P,3] with trainIds [P], sampled to 100 points, before and after pruning.

    Edges are counted as in the paper: directed, `k` per point before pruning.
    """
    rows = _sample(len(xyz), PRUNING_POINTS)
    xyz, cls = xyz[rows], cls[rows]
    figure = Figure(figsize=(10, 5.4), layout="constrained")
    for panel, (name, keep) in zip(figure.subplots(1, 2), (("before", 1.0), ("after", keep_inter_class)), strict=True):
        drawn = graph.build(xyz, cls, k, keep, np.random.default_rng(0))
        _draw_graph(panel, xyz, cls, drawn)
        panel.set_title(f"{name} pruning: {drawn.edges_kept} edges", fontsize="medium")
        panel.set(xlabel="x in m", ylabel="z in m", aspect="equal", adjustable="datalim")
    class_legend(figure, cls, columns=8)
    figure.suptitle(title)
    save_png_and_svg(figure, path)


def _sample(points: int, count: int) -> np.ndarray:
    return np.sort(np.random.default_rng(0).choice(points, min(count, points), replace=False))


def _draw_graph(panel: Axes, xyz: np.ndarray, cls: np.ndarray, drawn: graph.Graph) -> None:
    above = xyz[:, [0, 2]]
    source = np.repeat(np.arange(len(xyz)), drawn.degree)
    lines = np.stack([above[source], above[drawn.indices.astype(np.int64)]], axis=1)
    panel.add_collection(LineCollection([*lines], colors="0.7", linewidths=0.7, zorder=1))
    colours = classes.colourise(cls) / 255
    panel.scatter(above[:, 0], above[:, 1], c=colours, s=24, zorder=2, edgecolors="white", linewidths=0.4)
