"""Figure 3: a frame sampled to a hundred points, its kNN graph before and after semantic pruning."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pipeline.camera import classes
from pipeline.graphs import graph
from pipeline.report.figures.drawing import save
from pipeline.report.street_view import class_legend

POINTS = 100


def draw(path: Path, title: str, xyz: np.ndarray, cls: np.ndarray, k: int, keep_inter_class: float) -> None:
    """Draw a cloud xyz [P,3] with trainIds [P] from above; edges are counted as in the paper, directed: k a point."""
    rng = np.random.default_rng(0)
    some = np.sort(rng.choice(len(xyz), min(POINTS, len(xyz)), replace=False))
    xyz, cls = xyz[some], cls[some]
    figure = Figure(figsize=(10, 5.4), layout="constrained")
    for panel, (name, keep) in zip(figure.subplots(1, 2), (("before", 1.0), ("after", keep_inter_class)), strict=True):
        made = graph.build(xyz, cls, k, keep, np.random.default_rng(0))
        _draw_graph(panel, xyz, cls, made)
        panel.set_title(f"{name} pruning: {made.edges_kept} edges", fontsize="medium")
    class_legend(figure, cls, columns=8)
    figure.suptitle(title)
    save(figure, path)


def _draw_graph(panel: Axes, xyz: np.ndarray, cls: np.ndarray, made: graph.Graph) -> None:
    above = xyz[:, [0, 2]]
    source = np.repeat(np.arange(len(xyz)), made.degree)
    lines = np.stack([above[source], above[made.indices.astype(np.int64)]], axis=1)
    panel.add_collection(LineCollection([*lines], colors="0.75", linewidths=0.8, zorder=1))
    panel.scatter(
        above[:, 0], above[:, 1], c=classes.colourise(cls) / 255, s=26, zorder=2, edgecolors="white", linewidths=0.4
    )
    panel.set(xlabel="x in m", ylabel="z in m", aspect="equal")
    panel.set_adjustable("datalim")
