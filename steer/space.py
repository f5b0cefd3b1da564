"""Show the points and the graph of frames in 3D: a page with Plotly."""

import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from pipeline.base.store import DriveReader
from pipeline.camera import classes
from pipeline.report.street_view import View, read_view

# Largest number of frames of a drive that are shown.
FRAMES_SHOWN = 8
# Largest number of points that are shown of a frame.
POINTS_SHOWN = 3_000
# Largest number of edges that are drawn of a frame.
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
    "margin": {"l": 0, "r": 0, "t": 110, "b": 0},
    "scene": {
        "xaxis": {"title": "right, m", "range": [_LOWEST_M[0], _HIGHEST_M[0]]},
        "yaxis": {"title": "ahead, m", "range": [_LOWEST_M[1], _HIGHEST_M[1]]},
        "zaxis": {"title": "up, m", "range": [_LOWEST_M[2], _HIGHEST_M[2]]},
        # A metre has the same length along all axes. The camera's position is in units of 31 m.
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", (_HIGHEST_M - _LOWEST_M) / 31, strict=True)),
        # The view is from behind and above the car.
        "camera": {"eye": {"x": 0, "y": -1.5, "z": 0.9}, "center": {"z": -0.25}},
    },
}


def read_views(file: DriveReader) -> list[View]:
    """Read at most FRAMES_SHOWN frames, which are evenly spread over a drive."""
    count = min(FRAMES_SHOWN, len(file.frame))
    rows = np.linspace(0, len(file.frame) - 1, count).astype(int)
    return [read_view(number, file) for number in file.frame[rows].tolist()]


def write_page(path: Path, views: Sequence[View], title: str) -> None:
    """Write a page that shows frames in 3D."""
    text = html.escape(title)
    page = plot_frames(views, text).to_html(
        div_id="space",
        config={"responsive": True, "displayModeBar": False},
        default_height="min(95vh, 105vw)",
        auto_play=False,
    )
    path.write_text(page.replace("<head>", f"<head><title>{text}</title>", 1), encoding="utf-8")


def plot_frames(views: Sequence[View], title: str) -> go.Figure:
    """Plot the points of frames by class, and their edges, with a slider that selects a frame.

    Points and edges outside of the axes are left out. If a frame has too many edges, those near the
    car are shown. Below the title stand the numbers of the frame's points and edges.
    """
    present = np.unique(np.concatenate([np.asarray(view.points_cls) for view in views])).tolist()
    frames = []
    for view in views:
        traces = _draw_traces(view, present)
        frame = go.Frame(name=str(view.frame), data=traces)
        frame.layout.title = {"text": title, "subtitle": {"text": _count_shown(view, traces)}}
        frames.append(frame)

    figure = go.Figure(frames[0].data, _LAYOUT | {"sliders": [_make_slider(frames)]}, frames)
    figure.update_layout(title=frames[0].layout.title)
    figure.update_layout(title={"x": 0.01, "y": 1, "yanchor": "top", "pad": {"t": 12}})
    return figure


def _make_slider(frames: Sequence[go.Frame]) -> dict[str, Any]:
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


def _count_shown(view: View, traces: Sequence[go.Scatter3d]) -> str:
    """Return the numbers of the frame's points and edges, and how many of them the traces show."""
    shown = sum(len(trace.x) for trace in traces if trace.mode == "markers")
    aside_m, ahead_m, _ = _HIGHEST_M
    text = f"frame {view.frame}, up to {ahead_m} m ahead and {aside_m} m aside: "
    text += f"{shown:,} of {len(np.asarray(view.xyz)):,} points"
    if view.edges is not None:
        # The last trace has three rows for each edge.
        drawn = len(traces[-1].x) // 3 / max(len(view.edges), 1)
        text += f", {drawn:.0%} of {view.edge_count:,} directed edges"
    return text


def _draw_traces(view: View, present: Sequence[int]) -> list[go.Scatter3d]:
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
