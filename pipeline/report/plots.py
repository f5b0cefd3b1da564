"""Build the page's interactive plots.

They show errors, angles over time, learning curves, and points with their graph in 3D.
"""

import base64
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import cv2
import numpy as np
import pandas as pd
import plotly.graph_objects as go

from pipeline.camera import classes
from pipeline.report.street_view import View
from pipeline.report.summary import Comparison

# Colours of models, which repeat if there are more models.
COLOURS = ("#0b57a4", "#d1495b", "#2e8b57", "#8a5fbf", "#1b998b", "#7a6a53", "#c2185b")
# Number of models whose lines are visible at first; a click in the legend adds others.
MODELS_SHOWN = 3
# Largest number of points that are shown of a frame in 3D.
POINTS_SHOWN = 3_000
# Largest number of edges that are shown of a frame in 3D.
EDGES_SHOWN = 4_000
# nmse above which the chart of errors shows no value, since the others would be hard to tell apart.
CHART_LIMIT = 2.0
# Share of the width that a frame's image has beside its points, if there is one.
IMAGE_WIDTH = 0.4
# Quality of images in the page, from 0 to 100.
JPEG_QUALITY = 90
_LAYOUT = {
    "template": "none",
    "showlegend": True,
    "legend": {"orientation": "h", "itemsizing": "constant"},
}
_PLANE = _LAYOUT | {
    "margin": {"l": 50, "r": 10, "t": 10, "b": 50},
    "legend_y": -0.2,
    "legend_yanchor": "top",
}
# Least and largest coordinates in metres that are shown in 3D: right, ahead, up.
_LOWEST_M = np.array([-22, 0, -4])
_HIGHEST_M = np.array([22, 50, 10])
_SCENE = {
    "xaxis": {"title": "right, m", "range": [_LOWEST_M[0], _HIGHEST_M[0]]},
    "yaxis": {"title": "ahead, m", "range": [_LOWEST_M[1], _HIGHEST_M[1]]},
    "zaxis": {"title": "up, m", "range": [_LOWEST_M[2], _HIGHEST_M[2]]},
    # A metre has the same length along all axes. The camera's position is in units of 31 m.
    "aspectmode": "manual",
    "aspectratio": dict(zip("xyz", (_HIGHEST_M - _LOWEST_M) / 31, strict=True)),
    # The view is from behind and above the car.
    "camera": {"eye": {"x": 0, "y": -1.5, "z": 0.9}, "center": {"z": -0.25}},
}


def to_html(figure: go.Figure, name: str, height: str = "24rem", *, alone: bool = False) -> str:
    """Return a plot as a part of a page that has plotly.js, or with `alone` as a page of its own.

    `name` is the id of its element in the page.
    """
    config = {"responsive": True, "displayModeBar": False}
    return str(
        figure.to_html(
            div_id=name,
            config=config,
            default_height=height,
            full_html=alone,
            include_plotlyjs=alone,
            auto_play=False,
        )
    )


def errors(comparison: Comparison) -> go.Figure:
    """Plot the nmse of models and baselines with its 95 % interval, for each range of a path.

    Baselines that get the truth are not shown, nor are errors above CHART_LIMIT.
    """
    figure = go.Figure(layout=_PLANE | {"xaxis_title": "nmse", "yaxis_autorange": "reversed"})
    figure.update_layout(showlegend=len(comparison.labels) > 1, margin={"l": 130})
    for label in comparison.labels:
        values = []
        names = []
        above = []
        below = []
        for name in (*comparison.models, *comparison.fair_baselines):
            entry = comparison.entry(name, label)
            value = entry["value"]
            if value is not None and value < CHART_LIMIT:
                low, high = entry["interval"] or (value, value)
                values.append(value)
                names.append(name)
                above.append(high - value)
                below.append(value - low)
        interval = {"array": above, "arrayminus": below}
        figure.add_scatter(
            x=values, y=names, error_x=interval, mode="markers", name=label or "nmse"
        )
    return figure


def over_time(predictions: pd.DataFrame, comparison: Comparison, limit: float) -> go.Figure:
    """Plot driven values, odometry and predictions over the time of one drive.

    The best model is the first in the legend. The vertical axis ends at `limit` on both sides.
    """
    quantity = comparison.quantity
    title = quantity.axis_title()
    figure = go.Figure(layout=_PLANE | {"xaxis_title": "time in s", "yaxis_title": title})
    figure.update_yaxes(range=[-1.05 * limit, 1.05 * limit])

    value = f"%{{y:{quantity.shown_format}}} {quantity.shown_unit}"
    hover = value + " at %{x:.1f} s, frame %{text}"

    def add(rows: pd.DataFrame, column: str, name: str, **style: Any) -> None:
        if rows[column].isna().all():
            return
        figure.add_scatter(
            x=rows["elapsed_s"].to_numpy(np.float32),
            y=rows[column].to_numpy(np.float32),
            text=rows["frame"].tolist(),
            hovertemplate=hover,
            mode="lines",
            name=name,
            **style,
        )

    truth = predictions.drop_duplicates("frame").sort_values("frame")
    add(truth, "shown_true", "driven", line={"color": "#1b2027", "width": 3})
    add(truth, "shown_odometry", "odometry", line={"color": "#e08e0b", "dash": "dash"})
    for rank, (name, colour) in enumerate(zip(comparison.by_error, cycle(COLOURS), strict=False)):
        visible = True if rank < MODELS_SHOWN else "legendonly"
        rows = predictions[predictions["model"] == name]
        add(rows, "shown_predicted", name, line={"color": colour}, visible=visible)
    return figure


def learning(curves: Mapping[str, pd.DataFrame]) -> go.Figure:
    """Plot the learning curves of networks, which are named MODEL[.seed-N].

    A curve is the validation error, or a dotted curve of the training loss if a network has no
    validation error.
    """
    figure = go.Figure(layout=_PLANE | {"xaxis_title": "epoch"})
    figure.update_yaxes(title="error; 1: a constant angle")
    models = dict.fromkeys(network.split(".")[0] for network in curves)
    colours = dict(zip(models, cycle(COLOURS), strict=False))
    named = set()
    for network, curve in curves.items():
        model = network.split(".")[0]
        validated = curve["val_nmse"].notna().any()
        figure.add_scatter(
            x=curve["epoch"],
            y=curve["val_nmse" if validated else "train_loss"].to_numpy(np.float32),
            mode="lines",
            line={
                "color": colours[model],
                "dash": "solid" if validated else "dot",
                "width": 1.5,
            },
            name=model,
            hovertext=network,
            legendgroup=model,
            showlegend=model not in named,
        )
        named.add(model)
    return figure


def in_space(views: Sequence[View], title: str = "") -> go.Figure:
    """Plot the points of frames by class, and their edges, with a slider that selects a frame.

    Points and edges outside of the axes are left out. If a frame has too many edges, those near the
    car are shown. The image of a frame, if there is one, is beside its points. Below a `title`
    stand the numbers of the frame's points and edges.
    """
    present = np.unique(np.concatenate([np.asarray(view.points_cls) for view in views])).tolist()
    has_images = any(view.rgb is not None for view in views)
    frames = []
    for view in views:
        points = _traces(view, present)
        images = [_image(view)] if has_images else []
        frame = go.Frame(name=str(view.frame), data=[*points, *images])
        if title:
            frame.layout.title = {"text": title, "subtitle": {"text": _counts(view, points)}}
        frames.append(frame)

    layout = _LAYOUT | {
        "legend_y": 1.02,
        "legend_yanchor": "bottom",
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "scene": _SCENE,
        "sliders": [_slider(frames)],
    }
    figure = go.Figure(frames[0].data, layout, frames)
    if title:
        figure.update_layout(title=frames[0].layout.title, margin_t=110)
        figure.update_layout(title={"x": 0.01, "y": 1, "yanchor": "top", "pad": {"t": 12}})
    if has_images:
        figure.update_layout(scene_domain_x=[IMAGE_WIDTH, 1])
        figure.update_xaxes(visible=False, domain=[0, IMAGE_WIDTH])
        figure.update_yaxes(visible=False)
    return figure


def _slider(frames: Sequence[go.Frame]) -> dict[str, Any]:
    """Return a slider that has a step for each frame."""
    # A step shows its frame at once.
    now = {
        "mode": "immediate",
        "frame": {"duration": 0, "redraw": True},
        "transition": {"duration": 0},
    }
    steps = [
        {"label": frame.name, "method": "animate", "args": [[frame.name], now]} for frame in frames
    ]
    return {
        "steps": steps,
        "currentvalue": {"prefix": "frame "},
        "pad": {"t": 10, "l": 10, "r": 10, "b": 30},
    }


def _image(view: View) -> go.Image:
    """Return a trace of the frame's image, which is invisible if the frame has none."""
    if view.rgb is None:
        return go.Image(visible=False)
    bgr = view.rgb[..., ::-1]
    _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    text = base64.b64encode(jpeg.tobytes()).decode("ascii")
    return go.Image(source=f"data:image/jpeg;base64,{text}", visible=True, hoverinfo="skip")


def _counts(view: View, traces: Sequence[go.Scatter3d]) -> str:
    """Return how many of the frame's points and edges the traces show."""
    shown = sum(len(trace.x) for trace in traces if trace.mode == "markers")
    aside_m, ahead_m, _ = _HIGHEST_M
    text = f"frame {view.frame}, up to {ahead_m} m ahead and {aside_m} m aside: "
    text += f"{shown:,} of {len(np.asarray(view.xyz)):,} points"
    if view.edges is not None:
        # The last trace has three rows for each edge.
        text += f" and {len(traces[-1].x) // 3:,} of {len(view.edges):,} edges"
    return text


def _traces(view: View, present: Sequence[int]) -> list[go.Scatter3d]:
    """Return a trace for each class of `present`, and a trace for the edges, if any."""
    cls = np.asarray(view.points_cls)
    # Columns are right, ahead and up, as Plotly's z points up.
    xyz = np.asarray(view.xyz)[:, [0, 2, 1]] * np.array([1, 1, -1], np.float32)
    is_inside = np.all((xyz >= _LOWEST_M) & (xyz <= _HIGHEST_M), axis=1)
    shown = np.random.default_rng(0).permutation(np.flatnonzero(is_inside))[:POINTS_SHOWN]
    traces = []
    for number in present:
        x, y, z = xyz[shown[cls[shown] == number]].T
        name = classes.NAMES[number] if number < classes.COUNT else "no class"
        red, green, blue = classes.colourise(np.array(number)).tolist()
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
