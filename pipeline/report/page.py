"""Write the page: one HTML file that needs no other file and no network, from page.html.j2."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.camera.classes import VOID
from pipeline.report import plots
from pipeline.report.dvc_files import load_curves
from pipeline.report.figures import ERRORS
from pipeline.report.results import Results, load_structures
from pipeline.report.tables import Table

JPEG_QUALITY = 82
MAX_WIDTH = 1600  # pixels of a picture


class Plot(NamedTuple):
    caption: str
    figure: plots.Plot


class Picture(NamedTuple):
    caption: str
    jpeg: str  # in base64


Content = Sequence[str | Table | Plot | Picture]


def write_page(
    path: Path,
    story: Sequence[str],
    results: Results,
    tables: Sequence[Table],
    paths: Sequence[Table],
    perception: Sequence[Table],
    figures: Mapping[str, str],
    data: Path,
) -> None:
    """Write the page.

    Args:
        path: the HTML file; the files of `figures` are in folder figures beside it.
        story: sentences about the results.
        results: of all models.
        tables: of models and baselines, the most important first.
        paths: tables of the path ahead.
        perception: tables of depth, classes and motion.
        figures: name of a PNG file without suffix → caption; Figure 1 is shown first.
        data: holds a folder per stage; folders may be missing.
    """
    pictures = {name: _picture(caption, path.parent / f"figures/{name}.png") for name, caption in figures.items()}
    chain = pictures.pop("chain", None)
    shown = [] if results.models.empty else [*results.worst_drives(results.models)["drive"].unique()]
    sections: dict[str, Content] = {
        "Results": tables[:1],
        "Path ahead": paths,
        **_steering(results),
        "Largest errors": [pictures.pop(name) for name in [*pictures] if name.startswith(ERRORS)],
        "Figures of the paper": [*pictures.values()],
        "Graphs in 3D": _graphs(results, shown, data / "evaluate"),
        "Learning curves": _learning([*results.models["model"]], data / "train"),
        "Models in detail": tables[1:],
        "Depth, classes and motion": perception,
    }
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "ensure_ascii": False}
    html = environment.get_template("page.html.j2").render(
        story=story,
        chain=chain,
        sections={title: content for title, content in sections.items() if content},
        plotly=Markup(get_plotlyjs()),
    )
    with replacing(path) as unfinished:
        unfinished.write_text(html, encoding="utf-8")


def _steering(results: Results) -> dict[str, Content]:
    """Return a section of plots per horizon: only models of one horizon predict the same angle."""
    sections: dict[str, Content] = {}
    for horizon, rows in results.metrics.groupby("line.horizon") if len(results.metrics) else ():
        ahead = f", {horizon} frames ahead" if horizon else ""
        predictions = results.first_seed([*rows["model"]])
        shown = results.worst_drives(rows[~rows["baseline"].astype(bool)])
        drives, count = shown.groupby("drive", sort=False), predictions["drive"].nunique()
        chosen = (
            f" on the {len(drives)} of {count} drives with the largest squared error" if count > len(drives) else ""
        )
        sections[f"Steering on the test drives{ahead}"] = [
            f"Predictions of the first seed{chosen}. Drag to zoom, double-click to reset, click the legend to hide a "
            "line.",
            *(Plot(f"{drive}: steering over time{ahead}", plots.over_time(table)) for drive, table in drives),
            Plot(f"All test frames: predicted over driven steering{ahead}", plots.scatter(predictions)),
            Plot("Error by curvature of the road, mean over seeds", plots.by_curvature(rows)),
        ]
    return sections


def _graphs(results: Results, drives: Sequence[str], evaluate: Path) -> Content:
    for _, row in results.models.iterrows():
        structures = load_structures(evaluate / row["model"])
        graphs = {drive: structures[drive] for drive in drives if drive in structures}
        if graphs and pd.notna(row["variant.k"]):
            with_classes = any(set(graph.cls) != {VOID} for graph in graphs.values())
            legend = "classes, and edges before and after semantic pruning" if with_classes else "points and edges"
            text = (
                f"Input of {row['model']} where each of these drives bends most. Turn with the mouse; the legend shows "
                f"and hides {legend}."
            )
            captions = [f"{drive}, frame {graph.frame}: {graph.points:,} points" for drive, graph in graphs.items()]
            figures = [plots.graph_3d(graph, row["variant.k"]) for graph in graphs.values()]
            return [text, *map(Plot, captions, figures)]
    return []


def _learning(models: Sequence[str], train: Path) -> Content:
    curves = {model: load_curves(train / model) for model in models}
    first = {model: next(iter(runs.values())) for model, runs in curves.items() if runs}
    caption = "Training loss (dotted) and validation nmse of each model's first network"
    return [Plot(caption, plots.learning(first))] if first else []


def _picture(caption: str, path: Path) -> Picture:
    """Read a PNG file, at most MAX_WIDTH wide. Raises InputError if it is damaged."""
    image = cv2.imread(str(path))
    if image is None:
        raise InputError("not a picture", path, "Recreate it: dvc repro --force --single-item report")
    height, width = image.shape[:2]
    if width > MAX_WIDTH:
        size = (MAX_WIDTH, round(height * MAX_WIDTH / width))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    return Picture(caption, base64.b64encode(jpeg.tobytes()).decode("ascii"))
