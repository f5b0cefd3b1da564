"""A frame's graph to turn around: points in the colours of their classes, edges before and after semantic pruning."""

from typing import Any

import numpy as np
from plotly.graph_objects import Figure, Scatter3d

from pipeline.camera import classes
from pipeline.graphs import graph


def draw(structure: dict[str, Any], k: int) -> Figure:
    """Draw one drive's entry of structure.json; `k`: nearest neighbours that the graph was made with.

    Axes: x to the right, z forward, height upward, in metres of the camera frame.
    """
    xyz, cls = np.array(structure["xyz_m"], np.float32).reshape(-1, 3), np.array(structure["cls"], np.uint8)
    kept = np.array(structure["edges"], np.int64).reshape(-1, 2)
    before = edges(xyz, cls, k)
    place = np.stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]], axis=1)  # right, forward, up
    figure = Figure()
    for name, pairs, shown in (("before pruning", before, "legendonly"), ("after pruning", kept, True)):
        lines = np.full((len(pairs), 3, 3), np.nan, np.float32)  # a gap after each edge
        lines[:, 0], lines[:, 1] = place[pairs[:, 0]], place[pairs[:, 1]]
        x, y, z = lines.reshape(-1, 3).T
        figure.add_trace(
            Scatter3d(
                x=x, y=y, z=z, mode="lines", line={"color": "rgba(90,100,115,0.55)", "width": 1.5}, hoverinfo="skip",
                name=f"{len(pairs):,} edges {name}", visible=shown,
            )
        )  # fmt: skip
    for number in np.unique(cls):
        known = number < classes.COUNT
        colour = classes.COLOURS[number] if known else (0, 0, 0)
        x, y, z = place[cls == number].T
        figure.add_trace(
            Scatter3d(
                x=x, y=y, z=z, mode="markers", name=classes.NAMES[number] if known else "void",
                marker={"size": 3, "color": f"rgb({','.join(map(str, colour))})"},
                hovertemplate="%{x:.1f} m right, %{y:.1f} m ahead, %{z:.1f} m up",
            )
        )  # fmt: skip
    return figure.update_layout(
        template="plotly_white",
        height=560,
        margin={"l": 0, "r": 0, "t": 10, "b": 0},
        legend={"itemsizing": "constant", "orientation": "h", "y": 0, "yanchor": "top"},
        scene={
            "aspectmode": "data",
            "xaxis": {"title": {"text": "right, m"}},
            "yaxis": {"title": {"text": "ahead, m"}},
            "zaxis": {"title": {"text": "up, m"}},
            "camera": {"eye": {"x": 0.0, "y": -1.7, "z": 0.9}, "center": {"x": 0, "y": 0, "z": -0.15}},
        },
    )


def edges(xyz: np.ndarray, cls: np.ndarray, k: int) -> np.ndarray:
    """Return the undirected kNN edges [E,2] of points [P,3] before any is pruned, each once."""
    whole = graph.build(xyz, cls, k, 1.0, np.random.default_rng(0))
    pairs = np.stack([np.repeat(np.arange(len(xyz)), whole.degree), whole.indices.astype(np.int64)], axis=1)
    return pairs[pairs[:, 0] < pairs[:, 1]]
