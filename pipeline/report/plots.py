"""Build the interactive plots of the page, as data and layout of Plotly. Angles in degrees, left +."""

from collections.abc import Mapping
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd

from pipeline.camera import classes
from pipeline.evaluate.schema import Structure
from pipeline.graphs import graph, graph_file
from pipeline.report.results import columns_below, steering_lines

COLOURS = ("#0b57a4", "#d1495b", "#2e8b57", "#8a5fbf", "#1b998b", "#7a6a53", "#c2185b")
FIXED = {"driven": "#1b2027", "odometry": "#e08e0b", "zero": "#9aa3ad"}
MODELS_SHOWN = 3  # at first; a click in the legend adds others
SLIDER_S = 20.0  # drives longer than this get a range slider
_STEERING = "steering in deg, left +"
Plot = dict[str, Any]


def over_time(predictions: pd.DataFrame) -> Plot:
    """Plot driven steering, odometry and the predictions of each model over the time of one drive."""
    lines = steering_lines(predictions)
    special: dict[str, dict[str, Any]] = {"driven": {"line": {"width": 3}}, "odometry": {"line": {"dash": "dash"}}}
    traces = []
    for name, style in _styles(lines).items():
        rows = lines[name]
        hover = {"text": rows["frame"].tolist(), "hovertemplate": "%{y:.2f}° at %{x:.1f} s, frame %{text}"}
        traces.append(style | _points(rows, "elapsed_s", "deg") | hover | {"mode": "lines"} | special.get(name, {}))
        band = rows.dropna(subset="sigma_deg")
        if name not in special and len(band):
            edges = [band.assign(edge=band["deg"] + side * band["sigma_deg"]) for side in (1, -1)]
            outline = _points(pd.concat([edges[0], edges[1][::-1]]), "elapsed_s", "edge")
            fill = {"fill": "toself", "mode": "none", "fillcolor": f"{style['marker']['color']}26", "hoverinfo": "skip"}
            traces.append(style | outline | fill | {"name": f"{name} ± σ"})
    slider = {"visible": bool(predictions["elapsed_s"].max() > SLIDER_S)}
    return _plot(traces, 400, xaxis={**_title("time in s"), "rangeslider": slider}, yaxis=_title(_STEERING))


def scatter(predictions: pd.DataFrame) -> Plot:
    """Plot predicted over driven steering of all test frames, on equal axes that contain all points."""
    rows = predictions.dropna(subset=["driven_deg", "predicted_deg"])
    limit = 1.05 * float(np.abs(rows[["driven_deg", "predicted_deg"]].to_numpy()).max(initial=1.0))
    models = dict([*rows.groupby("model", sort=False)])
    traces = []
    for name, style in _styles(models).items():
        text = (models[name]["drive"] + ", frame " + models[name]["frame"].astype(str)).tolist()
        more = {"mode": "markers", "opacity": 0.6, "text": text, "hovertemplate": "%{y:.2f}° for %{x:.2f}°, %{text}"}
        traces.append(style | _points(models[name], "driven_deg", "predicted_deg") | more)
    diagonal = {"type": "line", "x0": -limit, "y0": -limit, "x1": limit, "y1": limit, "line": {"dash": "dot"}}
    equal = {"range": [-limit, limit], "constrain": "domain"}
    x, y = equal | _title(f"driven {_STEERING}"), equal | _title("predicted steering in deg") | {"scaleanchor": "x"}
    return _plot(traces, 560, xaxis=x, yaxis=y, shapes=[diagonal])


def by_curvature(metrics: pd.DataFrame) -> Plot:
    """Plot the RMSE of models and baseline zero in the ranges of |curvature| that have frames."""
    columns = columns_below(metrics, "test.by_curvature", "rmse_deg")
    frames = {name: metrics.iloc[0][f"test.by_curvature.{name}.frames"] for name in columns}
    rows = metrics.set_index("model")[[*columns.values()]].astype(float)
    rows = rows.set_axis([f"{name}<br>{frames[name]} frames" for name in columns], axis=1)
    rows = rows.dropna(how="all").dropna(how="all", axis=1).round(4)
    bars = [
        style | {"type": "bar", "x": [*rows], "y": _numbers(rows.loc[name])} for name, style in _styles(rows.T).items()
    ]
    return _plot(bars, 380, xaxis=_title("|curvature| of the road in 1/m"), yaxis=_title("RMSE in deg"))


def learning(curves: Mapping[str, pd.DataFrame]) -> Plot:
    """Plot training loss (dotted) and validation nmse of networks: name → epoch, train_loss, val_nmse."""
    traces = []
    for name, style in _styles(curves).items():
        for column, dash in (("train_loss", "dot"), ("val_nmse", "solid")):
            line = {"name": f"{name}, {column}", "mode": "lines", "line": {"dash": dash}}
            traces.append(style | _points(curves[name].astype(float), "epoch", column) | line)
    error = {**_title("error; 1: a constant angle"), "type": "log"}
    return _plot(traces, 400, xaxis=_title("epoch"), yaxis=error)


def graph_3d(structure: Structure, k: int) -> Plot:
    """Plot one drive's entry of structure.json: points in the colours of their classes, edges before and after pruning.

    Axes: right, ahead, up, in metres of the camera frame; `k` nearest neighbours before pruning.
    """
    xyz, cls = np.array(structure.xyz_m, np.float32).reshape(-1, 3), np.array(structure.cls, np.uint8)
    place = pd.DataFrame(np.stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]], axis=1), columns=[*"xyz"]).astype(float).round(3)
    traces: list[dict[str, Any]] = []
    for number in np.unique(cls):
        name = classes.NAMES[number] if number < classes.COUNT else "void"
        red, green, blue = classes.COLOURS[number] if number < classes.COUNT else (0, 0, 0)
        marker = {"size": 3, "color": f"rgb({red},{green},{blue})"}
        traces.append(_points(place[cls == number], *"xyz") | {"name": name, "mode": "markers", "marker": marker})
    built = graph.build(xyz, cls, k, 1.0, np.random.default_rng(0))
    unpruned = graph_file.edge_pairs(built.degree, built.indices)
    pruned = np.array(structure.edges, np.int64).reshape(-1, 2)
    lines = {"mode": "lines", "line": {"color": "rgba(90,100,115,0.55)", "width": 1.5}, "hoverinfo": "skip"}
    edges = {"edges": pruned}
    if (cls != classes.VOID).any():
        edges = {"edges before pruning": unpruned, "edges after pruning": pruned}
    for name, pairs in edges.items():
        ends = np.insert(pairs, 2, len(place), axis=1).ravel()  # a row without a point: a gap after each edge
        shown = {"name": name, "visible": True if pairs is pruned else "legendonly"}
        traces.append(_points(place.reindex(ends), *"xyz") | lines | shown)
    camera = {"eye": {"x": 0.0, "y": -2.0, "z": 1.1}, "center": {"x": 0, "y": -0.15, "z": -0.2}}
    axes = {f"{axis}axis": _title(f"{name}, m") for axis, name in zip("xyz", ("right", "ahead", "up"), strict=True)}
    scene = {"aspectmode": "data", "camera": camera, **axes}
    return _plot([trace | {"type": "scatter3d"} for trace in traces], 520, scene=scene)


def _styles(names: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return name → name, colour and visibility of its trace; all but the first models are hidden."""
    models = [name for name in names if name not in FIXED]
    colours = FIXED | dict(zip(models, cycle(COLOURS), strict=False))
    hidden = models[MODELS_SHOWN:]
    return {
        name: {"name": name, "marker": {"color": colours[name]}, "visible": "legendonly" if name in hidden else True}
        for name in names
    }


def _points(rows: pd.DataFrame, *columns: str) -> dict[str, list[float | None]]:
    """Return the coordinates of a trace: x, y and z from `columns`."""
    return {axis: _numbers(rows[column].round(4)) for axis, column in zip("xyz", columns, strict=False)}


def _numbers(values: pd.Series) -> list[float | None]:
    return [None if np.isnan(value) else value for value in values.tolist()]


def _title(text: str) -> dict[str, Any]:
    return {"title": {"text": text}}


def _plot(data: list[dict[str, Any]], height: int, **layout: Any) -> Plot:
    return {"data": data, "layout": {"height": height, **layout}}
