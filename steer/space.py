"""Show the points and the graph of frames in 3D: a page with Plotly."""

import base64
import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import plotly.graph_objects as go

from pipeline.base.store import DriveReader
from pipeline.camera import classes
from pipeline.report.street_view import View, read_view, with_image

# Largest number of frames of a drive that are shown.
FRAMES_SHOWN = 8
# Largest number of points that are shown of a frame.
POINTS_SHOWN = 3_000
# Largest number of edges that are drawn of a frame.
EDGES_SHOWN = 4_000
# Share of the width that a frame's image has beside its points, if there is one.
IMAGE_WIDTH = 0.4
# Quality of images in the page, from 0 to 100.
JPEG_QUALITY = 90
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


def read_some(file: DriveReader, ingest: DriveReader | None = None) -> list[View]:
    """Read at most FRAMES_SHOWN frames, which are evenly spread over a drive.

    They have the images of `ingest`, the drive's file of that stage, unless it is None.
    """
    count = min(FRAMES_SHOWN, len(file.frame))
    rows = np.linspace(0, len(file.frame) - 1, count).astype(int)
    views = [read_view(number, file) for number in file.frame[rows].tolist()]
    if ingest is not None:
        views = [with_image(view, ingest) for view in views]
    return views


def write_page(path: Path, views: Sequence[View], title: str) -> None:
    """Write a page that shows frames in 3D."""
    text = html.escape(title)
    page = in_space(views, text).to_html(
        div_id="space",
        config={"responsive": True, "displayModeBar": False},
        default_height="min(95vh, 105vw)",
        auto_play=False,
    )
    path.write_text(page.replace("<head>", f"<head><title>{text}</title>", 1), encoding="utf-8")


def in_space(views: Sequence[View], title: str) -> go.Figure:
    """Plot the points of frames by class, and their edges, with a slider that selects a frame.

    Points and edges outside of the axes are left out. If a frame has too many edges, those near the
    car are shown. The image of a frame, if there is one, is beside its points. Below the title
    stand the numbers of the frame's points and edges.
    """
    present = np.unique(np.concatenate([np.asarray(view.points_cls) for view in views])).tolist()
    has_images = any(view.rgb is not None for view in views)
    frames = []
    for view in views:
        points = _traces(view, present)
        images = [_image(view)] if has_images else []
        frame = go.Frame(name=str(view.frame), data=[*points, *images])
        frame.layout.title = {"text": title, "subtitle": {"text": _counts(view, points)}}
        frames.append(frame)

    figure = go.Figure(frames[0].data, _LAYOUT | {"sliders": [_slider(frames)]}, frames)
    figure.update_layout(title=frames[0].layout.title)
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
