"""Figures of the page, as plotly draws them. Angles in degrees, left +."""

import csv
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from plotly.graph_objects import Bar, Figure, Scatter, Scattergl

from pipeline.report.predicted import Steering
from pipeline.report.tables import comparison

COLOURS = ("#0b57a4", "#d1495b", "#2e8b57", "#8a5fbf", "#e08e0b", "#1b998b", "#7a6a53", "#c2185b")
TRUTH = "#1b2027"
AT_ONCE = 3  # models of a figure that are drawn; the others wait in its legend, or lines hide each other
SPEED_BINS_MPS = (0.0, 3.0, 6.0, 9.0, 12.0, 15.0)


def over_time(steering: Mapping[str, Steering]) -> Figure:
    """Draw driven and predicted steering of one drive, of model → what it says of that drive."""
    figure = _figure("time in s", "steering in deg, left +", height=440)
    first = next(iter(steering.values()))
    driven = {"color": TRUTH, "width": 3}
    figure.add_trace(Scatter(x=first.time_s, y=first.driven_deg, name="driven", mode="lines", line=driven))
    for number, (model, of) in enumerate(steering.items()):
        figure.add_trace(
            Scatter(
                x=of.time_s,
                y=of.predicted_deg,
                customdata=of.frame,
                mode="lines",
                hovertemplate="%{y:.1f} deg, frame %{customdata}",
                **_as_model(number, model, line=True),
            )
        )
    return figure.update_layout(hovermode="x unified", xaxis_rangeslider={"visible": True, "thickness": 0.08})


def scatter(steering: Mapping[str, Sequence[Steering]]) -> Figure:
    """Draw predicted over driven steering of all test frames, of model → its drives."""
    figure = _figure("driven steering in deg, left +", "predicted steering in deg", height=560)
    reach = max(np.nanmax(np.abs(of.driven_deg), initial=1.0) for drives in steering.values() for of in drives)
    right = {"color": TRUTH, "dash": "dot"}
    figure.add_trace(Scatter(x=[-reach, reach], y=[-reach, reach], name="right", mode="lines", line=right))
    for number, (model, drives) in enumerate(steering.items()):
        driven, predicted = (
            np.concatenate([getattr(of, name) for of in drives]) for name in ("driven_deg", "predicted_deg")
        )
        points = {"size": 5, "opacity": 0.6, "color": _colour(number)}
        figure.add_trace(Scattergl(x=driven, y=predicted, mode="markers", marker=points, **_as_model(number, model)))
    return figure.update_yaxes(scaleanchor="x", scaleratio=1)


def learning(models: Mapping[str, Path]) -> Figure:
    """Draw each model's learning curve, of model → its curve.csv: loss dotted, validation drawn out."""
    figure = _figure("epoch", "error; 1: that of a constant angle", height=440)
    for number, (model, path) in enumerate(models.items()):
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        epoch = [int(row["epoch"]) for row in rows]
        for column, dash in (("val_nmse", "solid"), ("train_loss", "dot")):
            values = [float(row[column]) if row[column] else None for row in rows]
            style = _as_model(number, f"{model}, {column}") | {"line": {"color": _colour(number), "dash": dash}}
            figure.add_trace(Scatter(x=epoch, y=values, mode="lines", **style))
    return figure.update_yaxes(type="log")


def by_curvature(results: Sequence[comparison.Result]) -> Figure:
    """Draw each model's RMSE where the road bends by so much."""
    bins = [row for row in results[0]["test"]["by_curvature"] if row["frames"]]
    names = [f"{comparison.bounds(row)} 1/m<br>{row['frames']} frames" for row in bins]
    figure = _figure("curvature of the road", "RMSE in deg", height=400)
    for number, result in enumerate(results):
        of_bins = {comparison.bounds(row): row for row in result["test"]["by_curvature"]}
        rmse = [of_bins.get(comparison.bounds(row), {}).get("rmse_deg") for row in bins]
        figure.add_trace(Bar(x=names, y=rmse, marker_color=_colour(number), **_as_model(number, result["model"])))
    return figure


def by_speed(steering: Mapping[str, Sequence[Steering]]) -> Figure:
    """Draw each model's RMSE at so many m/s, of model → its drives."""
    figure = _figure("speed in m/s", "RMSE in deg", height=400)
    edges = [*SPEED_BINS_MPS, np.inf]
    names = [f"{low:g} to {high:g}" if np.isfinite(high) else f"≥ {low:g}" for low, high in pairwise(edges)]
    for number, (model, drives) in enumerate(steering.items()):
        error = np.concatenate([of.predicted_deg - of.driven_deg for of in drives])
        of_bin = np.digitize(np.abs(np.concatenate([of.speed_mps for of in drives])), edges) - 1
        rmse = [_rms(error[(of_bin == number_of_bin) & ~np.isnan(error)]) for number_of_bin in range(len(names))]
        figure.add_trace(Bar(x=names, y=rmse, marker_color=_colour(number), **_as_model(number, model)))
    return figure


def _rms(values: np.ndarray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _figure(x: str, y: str, *, height: int) -> Figure:
    return Figure(
        layout={
            "template": "plotly_white",
            "height": height,
            "margin": {"l": 60, "r": 10, "t": 60, "b": 50},
            "xaxis": {"title": {"text": x}},
            "yaxis": {"title": {"text": y}},
            "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom"},
        }
    )


def _colour(number: int) -> str:
    return COLOURS[number % len(COLOURS)]


def _as_model(number: int, name: str, *, line: bool = False) -> dict[str, Any]:
    style = {"name": name, "visible": True if number < AT_ONCE else "legendonly"}
    return style | ({"line": {"color": _colour(number)}} if line else {})
