"""Write the page: sections of text, tables, plots and pictures, rendered by page.html.j2."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.graph_objects import Figure
from plotly.offline import get_plotlyjs

from pipeline.base import store
from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.report.dvc_files import load_curves
from pipeline.report.page import plots
from pipeline.report.results import Results
from pipeline.report.tables import Table

JPEG_QUALITY = 82
MAX_WIDTH = 1600  # pixels of a picture


class Plot(NamedTuple):
    caption: str
    figure: Figure

    @property
    def json(self) -> Markup:
        """Return the figure as JSON for a script element: without "<", no text can end the element."""
        return Markup(self.figure.to_json().replace("<", "\\u003c"))


class Picture(NamedTuple):
    caption: str
    path: Path

    @property
    def data(self) -> str:
        """Return the picture as a JPEG in base64. Raises InputError if the file is damaged."""
        image = cv2.imread(str(self.path))
        if image is None:
            raise InputError("not a picture", self.path, "Recreate it: dvc repro --force --single-item pictures")
        height, width = image.shape[:2]
        if width > MAX_WIDTH:
            size = (MAX_WIDTH, round(height * MAX_WIDTH / width))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
        return base64.b64encode(encoded.tobytes()).decode("ascii")


class Section(NamedTuple):
    """A heading with paragraphs, tables, plots and pictures."""

    title: str
    content: Sequence[str | Table | Plot | Picture]


def write_page(
    path: Path,
    story: Sequence[str],
    results: Results,
    tables: Sequence[Table],
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
        perception: tables of depth, classes and motion.
        figures: name of a PNG file without suffix → caption; Figure 1 is shown first.
        data: holds a folder per stage; folders may be missing.
    """
    pictures = {name: Picture(caption, path.parent / f"figures/{name}.png") for name, caption in figures.items()}
    chain = pictures.pop("chain", None)
    models = [*results.models["model"]]
    sections = [
        Section("Results", tables[:1]),
        *_steering(results),
        Section("Figures of the paper", [*pictures.values()]),
        Section("Graphs in 3D", _graphs(results, data / "evaluate")),
        Section("Learning curves", _learning(models, data / "train")),
        Section("Models in detail", tables[1:]),
        Section("Depth, classes and motion", perception),
        Section("Input of the test drives", _inputs(results, data / "pictures")),
    ]
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    html = environment.get_template("page.html.j2").render(
        story=story,
        chain=chain,
        sections=[section for section in sections if section.content],
        plotly=Markup(get_plotlyjs()),
    )
    with replacing(path) as unfinished:
        unfinished.write_text(html, encoding="utf-8")


def _steering(results: Results) -> list[Section]:
    """Return a section of plots per horizon: only models of one horizon predict the same angle."""
    sections = []
    for horizon, models in results.models.groupby("line.horizon") if len(results.metrics) else ():
        ahead = f", {horizon} frames ahead" if horizon else ""
        predictions = results.first_seed([*models["model"]])
        rows = results.metrics[results.metrics["line.horizon"] == horizon]
        content: list[str | Plot] = [
            "Predictions of the first seed. Drag to zoom, double-click to reset, click the legend to hide a line."
        ]
        for drive, table in predictions.groupby("drive", sort=False):
            content.append(Plot(f"{drive}: steering over time{ahead}", plots.over_time(table)))
        content += [
            Plot(f"All test frames: predicted over driven steering{ahead}", plots.scatter(predictions)),
            Plot("Error by curvature of the road, mean over seeds", plots.by_curvature(rows)),
        ]
        sections.append(Section(f"Steering on the test drives{ahead}", content))
    return sections


def _graphs(results: Results, evaluate: Path) -> list[str | Plot]:
    for _, row in results.models.iterrows():
        path = evaluate / row["model"] / "structure.json"
        graphs = store.read_json(path, stage=f"evaluate@{row['model']}") if path.is_file() else {}
        if graphs:
            text = (
                f"Input of {row['model']} where each test drive bends most. Turn with the mouse; the legend shows and "
                "hides classes, and edges before and after semantic pruning."
            )
            return [text, *(_graph(drive, graph, row["variant.k"]) for drive, graph in graphs.items())]
    return []


def _graph(drive: str, graph: dict[str, Any], k: int) -> Plot:
    return Plot(f"{drive}, frame {graph['frame']}: {graph['points']:,} points", plots.graph_3d(graph, k))


def _learning(models: Sequence[str], train: Path) -> list[str | Plot]:
    curves = {model: load_curves(train / model) for model in models}
    first = {model: next(iter(found.values())) for model, found in curves.items() if found}
    caption = "Training loss (dotted) and validation nmse of each model's first network"
    return [Plot(caption, plots.learning(first))] if first else []


def _inputs(results: Results, pictures: Path) -> list[Picture]:
    drives = pd.unique(results.predictions["drive"])
    sheets = {drive: pictures / f"{drive}.png" for drive in drives}
    caption = "{}: image, depth, classes, cloud from above"
    return [Picture(caption.format(drive), path) for drive, path in sheets.items() if path.is_file()]
