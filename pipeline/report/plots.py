"""Build the page's interactive plots: errors, angles over time, learning curves, and points with
their graph in 3D.
"""

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from pipeline.camera import classes
from pipeline.report.results import Group
from pipeline.report.street_view import View
from pipeline.report.summary import Results, key

COLOURS = ("#0b57a4", "#d1495b", "#2e8b57", "#8a5fbf", "#1b998b", "#7a6a53", "#c2185b")
Styles = dict[str, dict[str, Any]]
FIXED: Styles = {
    "driven": {"marker": {"color": "#1b2027"}, "line": {"width": 3}},
    "odometry": {"marker": {"color": "#e08e0b"}, "line": {"dash": "dash"}},
}
MODELS_SHOWN = 3  # the best at first; a click in the legend adds others
POINTS_SHOWN, EDGES_SHOWN = 3_000, 4_000  # of a frame in 3D
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
_AXES = {
    "xaxis": ("right, m", [-22, 22]),
    "yaxis": ("ahead, m", [0, 50]),
    "zaxis": ("up, m", [-4, 10]),
}
_SCENE = {name: {"title": title, "range": ends} for name, (title, ends) in _AXES.items()} | {
    "aspectmode": "data",
    # behind and above the car
    "camera": {"eye": {"x": 0, "y": -1.5, "z": 0.9}, "center": {"z": -0.25}},
}


def styles(groups: Sequence[Group]) -> Styles:
    """Return model or baseline → name, colour, line and visibility of its traces in all plots."""
    models = [row["model"] for group in groups for row in group.models]
    shown = {*FIXED, *(row["model"] for group in groups for row in group.by_error[:MODELS_SHOWN])}
    looks = {
        name: {"marker": {"color": colour}}
        for name, colour in zip(models, cycle(COLOURS), strict=False)
    } | FIXED
    return {
        name: {"name": name, "visible": name in shown or "legendonly", **looks[name]}
        for name in looks
    }


def to_html(figure: go.Figure, name: str, height: str = "24rem", *, alone: bool = False) -> str:
    """Return a plot as part of a page with plotly.js, or `alone` as a page; `name`: id of its
    element in the page.
    """
    options = {
        "default_height": height,
        "full_html": alone,
        "include_plotlyjs": alone,
        "auto_play": False,
    }
    return str(
        figure.to_html(div_id=name, config={"responsive": True, "displayModeBar": False}, **options)
    )


def errors(group: Group, figures: Results) -> go.Figure:
    """Plot the nmse of each model and baseline with its 95 % interval, a range of a path beside the
    other.
    """
    figure = go.Figure(layout=_PLANE | {"xaxis_title": "nmse", "yaxis": {"autorange": "reversed"}})
    figure.update_layout(showlegend=len(group.labels) > 1, margin={"l": 130})
    for label in group.labels.values():
        entries = [figures[key(group.key, name, label)] for name in group.predicted]
        values = [entry["figure"] for entry in entries]
        ends = [entry["interval"] or (entry["figure"], entry["figure"]) for entry in entries]
        bars = {
            "array": [
                high - value
                for value, (_, high) in zip(values, ends, strict=True)
                if value is not None
            ],
            "arrayminus": [
                value - low
                for value, (low, _) in zip(values, ends, strict=True)
                if value is not None
            ],
        }
        figure.add_scatter(
            x=values, y=[*group.predicted], error_x=bars, mode="markers", name=label or "nmse"
        )
    return figure


def over_time(predictions: pd.DataFrame, look: Styles, limit_deg: float) -> go.Figure:
    """Plot driven angle, odometry and the predictions of each model over the time of one drive, in
    degrees, left +.

    `limit_deg`: end of the axis on both sides.
    """
    truth = predictions.drop_duplicates("frame").sort_values("frame")
    lines = {"driven": (truth, "true_deg"), "odometry": (truth, "odometry_deg")}
    lines |= {
        name: (rows, "predicted_deg") for name, rows in predictions.groupby("model", sort=False)
    }
    figure = go.Figure(layout=_PLANE | {"xaxis_title": "time in s", "yaxis_title": "deg, left +"})
    figure.update_yaxes(range=[-1.05 * limit_deg, 1.05 * limit_deg])
    for name, (rows, column) in lines.items():
        if rows[column].notna().any():
            hover = {
                "text": rows["frame"].tolist(),
                "hovertemplate": "%{y:.2f}° at %{x:.1f} s, frame %{text}",
            }
            x, y = (rows[key].to_numpy(np.float32) for key in ("elapsed_s", column))
            figure.add_scatter(x=x, y=y, mode="lines", **hover, **look[name])
    return figure


def learning(curves: dict[str, pd.DataFrame], look: Styles) -> go.Figure:
    """Plot the curves of networks MODEL[.seed-N]: training loss, dotted, of those without
    validation.
    """
    figure = go.Figure(
        layout=_PLANE | {"xaxis_title": "epoch", "yaxis_title": "error; 1: a constant angle"}
    )
    # model → its first network
    legend = {network.split(".")[0]: network for network in reversed(curves)}
    for network, curve in curves.items():
        model, validated = network.split(".")[0], curve["val_nmse"].notna().any()
        group = {
            "legendgroup": model,
            "showlegend": legend[model] == network,
            "hovertext": network,
            "visible": True,
        }
        line = {"dash": "solid" if validated else "dot", "width": 1.5}
        y = curve["val_nmse" if validated else "train_loss"].to_numpy(np.float32)
        figure.add_scatter(
            x=curve["epoch"], y=y, mode="lines", **look[model] | group | {"line": line}
        )
    return figure


def in_space(views: Sequence[View]) -> go.Figure:
    """Show points of some frames by class, with a slider, and their edges; of too many edges those
    near the car.
    """
    present = np.unique(np.concatenate([np.asarray(view.points_cls) for view in views])).tolist()
    frames = [go.Frame(name=str(view.frame), data=_traces(view, present)) for view in views]
    now = {
        "mode": "immediate",
        "frame": {"duration": 0, "redraw": True},
        "transition": {"duration": 0},
    }
    steps = [
        {"label": frame.name, "method": "animate", "args": [[frame.name], now]} for frame in frames
    ]
    slider = {
        "steps": steps,
        "currentvalue": {"prefix": "frame "},
        "pad": {"t": 10, "l": 10, "r": 10, "b": 30},
    }
    above = {
        "legend_y": 1.02,
        "legend_yanchor": "bottom",
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
    }
    return go.Figure(
        frames[0].data, _LAYOUT | above | {"scene": _SCENE, "sliders": [slider]}, frames
    )


def _traces(view: View, present: Sequence[int]) -> list[go.Scatter3d]:
    """Return a trace for each class of `present`, and one of the edges."""
    cls = np.asarray(view.points_cls)
    # Plotly's z points up
    xyz = np.asarray(view.xyz)[:, [0, 2, 1]] * np.array([1, 1, -1], np.float32)
    shown, parts = np.random.default_rng(0).permutation(len(xyz))[:POINTS_SHOWN], []
    for number in present:
        name = classes.NAMES[number] if number < classes.COUNT else "no class"
        marker = {"size": 2, "color": f"rgb{tuple(classes.colourise(np.array(number)).tolist())}"}
        parts.append(
            (xyz[shown[cls[shown] == number]], {"name": name, "mode": "markers", "marker": marker})
        )
    if view.edges is not None:
        nearest = view.edges[np.argsort(xyz[view.edges[:, 0], 1], kind="stable")[:EDGES_SHOWN]]
        lines = np.insert(xyz[nearest], 2, np.nan, axis=1).reshape(-1, 3)  # NaN: a gap
        parts.append(
            (lines, {"name": "edges", "mode": "lines", "line": {"width": 1.5, "color": "#8b95a1"}})
        )
    return [
        go.Scatter3d(dict(zip("xyz", points.T, strict=True)) | style) for points, style in parts
    ]
