"""Write the page: one HTML file that needs no other file and no network, from page.html.j2."""

import base64
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from plotly.offline import get_plotlyjs

from pipeline.camera import classes
from pipeline.report.figures import Figures
from pipeline.report.results import Group
from pipeline.report.street_view import View
from pipeline.report.tables import Table

COLOURS = ("#0b57a4", "#d1495b", "#2e8b57", "#8a5fbf", "#1b998b", "#7a6a53", "#c2185b")
Trace = dict[str, Any]  # of Plotly, with angles in degrees, left +
Styles = dict[str, Trace]
FIXED: Styles = {
    "driven": {"marker": {"color": "#1b2027"}, "line": {"width": 3}},
    "odometry": {"marker": {"color": "#e08e0b"}, "line": {"dash": "dash"}},
}
MODELS_SHOWN = 3  # the best at first; a click in the legend adds others
DRIVES_SHOWN = 6  # those with most squared error of the best model; the tables have all
POINTS_SHOWN, EDGES_SHOWN = 3_000, 10_000  # in space


class Plot(NamedTuple):
    caption: str
    traces: list[Trace]


class Picture(NamedTuple):
    caption: str
    png: str  # in base64


Content = Sequence[str | Table | Plot | Picture]


def write_page(
    path: Path, story: list[str], groups: list[Group], tables: list[Table], perception: Content, figures: Figures
) -> None:
    """Write the page beside folder figures. `perception`: where the encoder's weights come from, and tables."""
    captions, frame = figures
    pictures = {
        name: Picture(caption, base64.b64encode((path.parent / f"figures/{name}.png").read_bytes()).decode("ascii"))
        for name, caption in captions.items()
    }
    chain, look = pictures.pop("chain", None), styles(groups)
    results = [table for table in tables if table.title.startswith(("Results", "The paper's claims"))]
    sections: dict[str, Content] = {
        "Results": results,
        **{f"Test drives: {group.title}": _test_drives(group, look) for group in groups},
        "Largest errors": [*pictures.values()],
        "Models in detail": [table for table in tables if table not in results],
        "Depth, classes and motion": perception,
    }
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "ensure_ascii": False}
    html = environment.get_template("page.html.j2").render(
        story=story,
        chain=chain,
        space=frame and in_space(*frame),
        sections={title: content for title, content in sections.items() if content},
        plotly=get_plotlyjs(),
    )
    path.write_text(html, encoding="utf-8")


def _test_drives(group: Group, look: Styles) -> Content:
    predictions, best = group.predictions, group.first_seed(group.by_error[0]["model"])
    worst = best.groupby("drive", sort=False)["cost"].sum().nlargest(DRIVES_SHOWN).index
    count = predictions["drive"].nunique()
    chosen = f" on the {len(worst)} of {count} drives with the largest squared error" if count > len(worst) else ""
    angle = " The angle is the turn of the path over all ranges." if any(group.labels.values()) else ""
    hint = "Drag to zoom, double-click to reset, click the legend to hide."
    drives = predictions[predictions["drive"].isin(worst)].groupby("drive", sort=False)
    plots = [Plot(f"{drive}: {group.title} over time", over_time(rows, look)) for drive, rows in drives]
    return [f"Predictions of the first seed{chosen}.{angle} {hint}", *plots]


def styles(groups: Sequence[Group]) -> Styles:
    """Return model or baseline → name, colour, line and visibility of its traces in all plots."""
    models = [row["model"] for group in groups for row in group.models]
    shown = {*FIXED, *(row["model"] for group in groups for row in group.by_error[:MODELS_SHOWN])}
    looks = {name: {"marker": {"color": colour}} for name, colour in zip(models, cycle(COLOURS), strict=False)} | FIXED
    return {name: {"name": name, "visible": name in shown or "legendonly", **looks[name]} for name in looks}


def over_time(predictions: pd.DataFrame, look: Styles) -> list[Trace]:
    """Return the curves of driven angle, odometry and the predictions of each model over the time of one drive."""
    traces = []
    truth = predictions.drop_duplicates("frame").sort_values("frame")
    lines = {"driven": (truth, "true_deg"), "odometry": (truth, "odometry_deg")}
    lines |= {name: (rows, "predicted_deg") for name, rows in predictions.groupby("model", sort=False)}
    for name, (rows, column) in lines.items():
        if rows[column].isna().all():
            continue
        hover = {"text": rows["frame"].tolist(), "hovertemplate": "%{y:.2f}° at %{x:.1f} s, frame %{text}"}
        # Plotly draws None as a gap.
        y = [None if np.isnan(value) else value for value in rows[column].round(4).tolist()]
        traces.append(look[name] | {"x": rows["elapsed_s"].round(4).tolist(), "y": y, "mode": "lines"} | hover)
    return traces


def in_space(cloud: View, graph: View) -> Plot:
    """Return a frame's points in the colours of their classes, and its graph; of too many edges those near the car."""
    cls, edges = np.asarray(cloud.points_cls), np.asarray(graph.edges)
    xyz, nodes = ((np.asarray(view.xyz) * [1.0, -1.0, 1.0]).round(3) for view in (cloud, graph))  # Plotly's z points up
    shown = np.random.default_rng(0).permutation(len(xyz))[:POINTS_SHOWN]
    nearest = edges[np.argsort(nodes[edges[:, 0], 2], kind="stable")[:EDGES_SHOWN]]
    lines = np.insert(nodes[nearest].astype(object), 2, np.array(None), axis=1).reshape(-1, 3)  # None: a gap
    colours = [f"rgb{tuple(colour)}" for colour in classes.colourise(cls[shown]).tolist()]
    traces: list[Trace] = [
        {"name": "cloud", "mode": "markers", "marker": {"size": 2, "color": colours}},
        {"name": "graph", "mode": "lines", "line": {"width": 1.5, "color": "#8b95a1"}},
    ]
    for trace, points in zip(traces, (xyz[shown], lines), strict=True):
        trace |= {"type": "scatter3d"} | dict(zip("xzy", points.T.tolist(), strict=True))
    return Plot(f"The same frame in 3D, to turn by mouse: {len(shown):,} points of the cloud, and the graph", traces)
