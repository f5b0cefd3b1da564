"""Build the interactive plots of the page. Angles in degrees, left +."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import plotly.express as px
from plotly.basedatatypes import BaseTraceType
from plotly.graph_objects import Figure

from pipeline.camera import classes
from pipeline.graphs import graph
from pipeline.report.results import columns_below

COLOURS = ["#1b998b", "#7a6a53", "#c2185b", "#0b57a4", "#d1495b", "#2e8b57", "#8a5fbf"]  # plotly skips len(FIXED)
FIXED = {"driven": "#1b2027", "odometry": "#e08e0b", "zero": "#9aa3ad"}
MODELS_SHOWN = 3  # at first; a click in the legend adds others
SLIDER_S = 20.0  # drives longer than this get a range slider
_LEGEND = {"orientation": "h", "title": "", "y": 1.02, "yanchor": "bottom"}
_STEERING = "steering in deg, left +"


def over_time(predictions: pd.DataFrame) -> Figure:
    """Plot driven steering, odometry and the predictions of each model over the time of one drive."""
    truth = predictions.drop_duplicates("frame").sort_values("frame")
    lines = [truth.assign(line=name, deg=truth[f"{name}_deg"]) for name in ("driven", "odometry")]
    rows = pd.concat([*lines, predictions.assign(line=predictions["model"], deg=predictions["predicted_deg"])])
    rows = rows[rows.groupby("line")["deg"].transform("count") > 0]  # without motion, there is no odometry
    axes = {"elapsed_s": "time in s", "deg": _STEERING}
    figure = px.line(rows, x="elapsed_s", y="deg", color="line", labels=axes, hover_data=["frame"], **_style())
    figure.update_traces(selector={"name": "driven"}, line_width=3).update_traces(
        selector={"name": "odometry"}, line_dash="dash"
    )
    for model, own in predictions.dropna(subset=["sigma_deg"]).groupby("model"):
        edges = [own["predicted_deg"] + side * own["sigma_deg"] for side in (1, -1)]
        x, y = (pd.concat([first, last[::-1]]) for first, last in ([own["elapsed_s"]] * 2, edges))
        figure.add_scatter(x=x, y=y, fill="toself", mode="none", opacity=0.3, name=f"{model} ± σ", hoverinfo="skip")
    figure.update_xaxes(rangeslider_visible=bool(truth["elapsed_s"].max() > SLIDER_S))
    return _finish(figure, 400)


def scatter(predictions: pd.DataFrame) -> Figure:
    """Plot predicted over driven steering of all test frames, on equal axes that contain all points."""
    rows = predictions.dropna(subset=["driven_deg", "predicted_deg"])
    limit = 1.05 * float(np.abs(rows[["driven_deg", "predicted_deg"]].to_numpy()).max(initial=1.0))
    axes = {"driven_deg": "driven steering in deg, left +", "predicted_deg": "predicted steering in deg"}
    more = {"opacity": 0.6, "labels": axes, "hover_data": ["drive", "frame"]}
    figure = px.scatter(rows, x="driven_deg", y="predicted_deg", color="model", **more, **_style())
    figure.add_shape(type="line", x0=-limit, y0=-limit, x1=limit, y1=limit, line={"dash": "dot", "width": 1.5})
    figure.update_xaxes(range=[-limit, limit], constrain="domain")
    figure.update_yaxes(range=[-limit, limit], constrain="domain", scaleanchor="x")
    return _finish(figure, 560)


def by_curvature(metrics: pd.DataFrame) -> Figure:
    """Plot the RMSE of models and baseline zero in the ranges of |curvature| that have frames."""
    columns = columns_below(metrics, "test.by_curvature", "rmse_deg")
    rows = metrics.set_index("model")[[*columns.values()]].dropna(how="all").dropna(how="all", axis=1)
    frames = {name: metrics.iloc[0][f"test.by_curvature.{name}.frames"] for name in columns}
    names = {column: f"{name}<br>{frames[name]} frames" for name, column in columns.items()}
    rows = rows.rename(columns=names).T.astype(float).rename_axis(index="range", columns="model")
    bars = rows.stack().rename("rmse").reset_index()
    axes = {"range": "|curvature| of the road in 1/m", "rmse": "RMSE in deg"}
    figure = px.bar(bars, x="range", y="rmse", color="model", barmode="group", labels=axes, **_style())
    return _finish(figure, 380)


def learning(curves: Mapping[str, pd.DataFrame]) -> Figure:
    """Plot training loss (dotted) and validation nmse of networks: name → epoch, train_loss, val_nmse."""
    rows = pd.concat([curve.astype(float).melt("epoch").assign(model=name) for name, curve in curves.items()])
    more = {"line_dash": "variable", "line_dash_map": {"val_nmse": "solid", "train_loss": "dot"}}
    axes = {"value": "error; 1: a constant angle"}
    figure = px.line(rows, x="epoch", y="value", color="model", log_y=True, labels=axes, **more, **_style())
    return _finish(figure, 400)


def graph_3d(structure: Mapping[str, Any], k: int) -> Figure:
    """Plot one drive's entry of structure.json: points in the colours of their classes, edges before and after pruning.

    Axes: right, ahead, up, in metres of the camera frame; `k` nearest neighbours before pruning.
    """
    xyz, cls = np.array(structure["xyz_m"], np.float32).reshape(-1, 3), np.array(structure["cls"], np.uint8)
    place = np.stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]], axis=1)
    axes = ["right, m", "ahead, m", "up, m"]
    points = pd.DataFrame(place, columns=axes)
    names = {number: classes.NAMES[number] if number < classes.COUNT else "void" for number in np.unique(cls)}
    colours = {name: _rgb(classes.COLOURS[number]) for number, name in names.items() if number < classes.COUNT}
    points["class"] = [names[number] for number in cls]
    figure = px.scatter_3d(points, *axes, color="class", color_discrete_map=colours | {"void": "black"})
    figure.update_traces(marker_size=3)
    pruned = np.array(structure["edges"], np.int64).reshape(-1, 2)
    for name, pairs in (("edges before pruning", unpruned_edges(xyz, cls, k)), ("edges after pruning", pruned)):
        lines = np.full((len(pairs), 3, 3), np.nan, np.float32)  # NaN: a gap after each edge
        lines[:, 0], lines[:, 1] = place[pairs[:, 0]], place[pairs[:, 1]]
        edges = px.line_3d(pd.DataFrame(lines.reshape(-1, 3), columns=axes), *axes)
        style = {"line_color": "rgba(90,100,115,0.55)", "line_width": 1.5, "hoverinfo": "skip", "hovertemplate": None}
        edges.update_traces(name=name, showlegend=True, visible=True if pairs is pruned else "legendonly", **style)
        figure.add_traces(edges.data)
    camera = {"eye": {"x": 0.0, "y": -1.7, "z": 0.9}, "center": {"x": 0, "y": 0, "z": -0.15}}
    figure.update_layout(scene={"aspectmode": "data", "camera": camera}, legend_itemsizing="constant")
    return _finish(figure, 520)


def unpruned_edges(xyz: np.ndarray, cls: np.ndarray, k: int) -> np.ndarray:
    """Return the undirected kNN edges [E,2] of points [P,3], each once."""
    complete = graph.build(xyz, cls, k, 1.0, np.random.default_rng(0))
    pairs = np.stack([np.repeat(np.arange(len(xyz)), complete.degree), complete.indices.astype(np.int64)], axis=1)
    return pairs[pairs[:, 0] < pairs[:, 1]]


def _rgb(colour: np.ndarray) -> str:
    red, green, blue = colour
    return f"rgb({red},{green},{blue})"


def _style() -> dict[str, Any]:
    return {"color_discrete_sequence": COLOURS, "color_discrete_map": FIXED}


def _finish(figure: Figure, height: int) -> Figure:
    """Set the layout, and hide all but the first models."""
    models = list(dict.fromkeys(_model(trace) for trace in figure.data if trace.name not in FIXED))
    for trace in figure.data:
        if trace.type != "scatter3d" and _model(trace) in models[MODELS_SHOWN:]:
            trace.visible = "legendonly"
    margin = {"l": 60, "r": 10, "t": 40, "b": 50}
    return figure.update_layout(template="plotly_white", height=height, margin=margin, legend=_LEGEND, showlegend=True)


def _model(trace: BaseTraceType) -> str:
    return str(trace.name).split(", ")[0]  # of learning curves: model, column
