"""Show the points and the graph of a frame in 3D: a page with Plotly."""

import base64
import html
from pathlib import Path

import cv2
import numpy as np
import plotly.graph_objects as go

from pipeline.camera import classes
from pipeline.report.street_view import View

# Largest number of points that are shown.
POINTS_SHOWN = 3_000
# Largest number of edges that are drawn.
EDGES_SHOWN = 4_000
# Least and largest coordinates in metres that are shown: right, ahead, up.
_LOWEST_M = np.array([-22, 0, -4])
_HIGHEST_M = np.array([22, 50, 10])
_LAYOUT = {
    "template": "none",
    "showlegend": True,
    "legend": {
        "orientation": "h",
        "itemsizing": "constant",
        "y": 1.02,
        "yanchor": "bottom",
    },
    "margin": {"l": 0, "r": 0, "t": 70, "b": 20},
    "scene": {
        "xaxis": {"title": "right, m", "range": [_LOWEST_M[0], _HIGHEST_M[0]]},
        "yaxis": {"title": "ahead, m", "range": [_LOWEST_M[1], _HIGHEST_M[1]]},
        "zaxis": {"title": "up, m", "range": [_LOWEST_M[2], _HIGHEST_M[2]]},
        # A metre has the same length along all axes. The camera's position is in units of 31 m.
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", (_HIGHEST_M - _LOWEST_M) / 31, strict=True)),
        # The view is from behind and above the car.
        "camera": {"eye": {"x": 0, "y": -2.0, "z": 1.2}, "center": {"z": -0.2}},
    },
}


# The image and the points are side by side where both fit, otherwise one above the other.
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
body {{ margin: 12px; font: 15px/1.5 sans-serif; }}
h1 {{ margin: 0; font-size: 17px; overflow-wrap: anywhere; }}
main {{ display: flex; flex-wrap: wrap; gap: 12px; align-items: flex-start; }}
img {{ flex: 1 1 320px; min-width: 0; max-width: 640px; }}
main > div {{ flex: 3 1 360px; min-width: 0; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p>{count}</p>
<main>{image}{plot}</main>
</body>
</html>
"""


def write_page(path: Path, view: View, title: str) -> None:
    """Write a page that shows a frame in 3D, beside its image if the view has one."""
    figure = plot_frame(view)
    count = 0
    for trace in figure.data:
        if trace.mode == "markers":
            count += len(trace.x)
    image = ""
    if view.rgb is not None:
        _, png = cv2.imencode(".png", cv2.cvtColor(view.rgb, cv2.COLOR_RGB2BGR))
        encoded = base64.b64encode(png.tobytes()).decode()
        image = f'<img alt="the image of the frame" src="data:image/png;base64,{encoded}">'
    plot = figure.to_html(
        div_id="space",
        full_html=False,
        config={"responsive": True, "displayModeBar": False},
        default_height="min(85vh, 110vw)",
    )
    page = _PAGE.format(
        title=html.escape(title),
        count=f"{count:,} of {len(np.asarray(view.xyz)):,} points are shown.",
        image=image,
        plot=plot,
    )
    path.write_text(page, encoding="utf-8")


def plot_frame(view: View) -> go.Figure:
    """Plot the points of a frame by class, and its edges.

    Points and edges outside of the axes are left out. If a frame has too many points, some are
    drawn at random. If it has too many edges, those near the car are shown.
    """
    return go.Figure(_draw_traces(view), _LAYOUT)


def _draw_traces(view: View) -> list[go.Scatter3d]:
    """Return a trace for each class of the points, and a trace for the edges, if any."""
    cls = np.asarray(view.points_cls)
    # Columns are right, ahead and up, as Plotly's z points up.
    xyz = np.asarray(view.xyz)[:, [0, 2, 1]] * np.array([1, 1, -1], np.float32)
    is_inside = np.all((xyz >= _LOWEST_M) & (xyz <= _HIGHEST_M), axis=1)
    shown = np.random.default_rng(0).permutation(np.flatnonzero(is_inside))[:POINTS_SHOWN]
    traces = []
    for number in np.unique(cls).tolist():
        x, y, z = xyz[shown[cls[shown] == number]].T
        name = classes.NAMES[number] if number < classes.COUNT else "no class"
        red, green, blue = classes.colour_classes(np.array(number)).tolist()
        marker = {"size": 2, "color": f"rgb({red}, {green}, {blue})"}
        traces.append(go.Scatter3d(x=x, y=y, z=z, name=name, mode="markers", marker=marker))
    if view.edges is not None:
        edges = view.edges[is_inside[view.edges].all(axis=1)]
        nearest = np.argsort(xyz[edges[:, 0], 1], kind="stable")[:EDGES_SHOWN]
        ends = xyz[edges[nearest]]  # [E,2,3]
        # A NaN after each edge makes a gap in the line.
        x, y, z = np.insert(ends, 2, np.nan, axis=1).reshape(-1, 3).T
        line = {"width": 1.5, "color": "#8b95a1"}
        traces.append(go.Scatter3d(x=x, y=y, z=z, name="edges", mode="lines", line=line))
    return traces
