"""Write the page: one HTML file that needs no other file and no network, from page.html.j2."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import yaml
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from pipeline.report import figures, plots
from pipeline.report.origin import duration, origin, read_run
from pipeline.report.results import Group
from pipeline.report.summary import Comparison
from pipeline.report.tables import Table

# Caption of the learning curves.
_LEARNING = (
    "Each line is a seed: nmse on the validation drives; dotted, without these, the training loss."
)
# Beginning of the caption of a chart of errors.
_ERRORS = "nmse on the test drives, with its 95 % interval; 0 is perfect, 1 is useless; "
_ERRORS += "values above 2 are in the tables only"
# Caption of the points and edges in 3D.
_SPACE = (
    "Points and edges of the same drive in 3D. Drag to turn, move the slider, click a class to "
    "hide it."
)


# What to do after the demo.
NEXT = "add a network to models in params.yaml, and run dvc repro (README, Add yours)"


class Figure(NamedTuple):
    """A picture or plot as HTML, with its caption."""

    caption: str
    html: str


Content = Sequence[str | Table | Figure]


@dataclass
class Page:
    """The content of the page from top to bottom."""

    sentences: Sequence[str]  # the first one is the headline
    picture: Figure | None  # what stands below the headline
    doubts: Sequence[str]
    sections: Mapping[str, Content]  # title → content; a section without content is left out


def write(path: Path, page: Page) -> None:
    """Write a page, which ends with the origin of its results."""
    run = read_run()
    made = origin()
    if "started_s" in run:
        made["duration"] = duration(run)
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    html = environment.get_template("page.html.j2").render(
        page=page,
        made=made,
        settings=yaml.safe_dump(run.get("settings", {}), allow_unicode=True, sort_keys=False),
        next=run.get("next", NEXT),
        plotly=get_plotlyjs(),
    )
    path.write_text(html, encoding="utf-8")


def picture(path: Path, caption: str) -> Figure:
    """Return a PNG file as part of the page."""
    png = base64.b64encode(path.read_bytes()).decode("ascii")
    tag = Markup('<img src="data:image/png;base64,{}" alt="{}" loading="lazy">')
    return Figure(caption, tag.format(png, caption))


def errors(comparisons: Sequence[Comparison]) -> Content:
    """Return a chart of the errors of each group."""
    charts = []
    for comparison in comparisons:
        height = f"{4 + 2 * len(comparison.models + comparison.fair_baselines)}rem"
        plot = plots.to_html(plots.errors(comparison), f"{comparison.group}-errors", height)
        charts.append(Figure(f"{_ERRORS}: {comparison.title}.", plot))
    return charts


def bend(pictures: Path, group: Group, comparison: Comparison, ingest: Path) -> Figure | None:
    """Return a picture of the predicted paths at a bend, or None if its image is missing.

    The picture is also written to the folder `pictures`. `ingest` is the folder of that stage.
    """
    path = pictures / "bend.png"
    caption = figures.draw_bend(path, group, comparison, ingest)
    return picture(path, caption) if caption else None


def chain(pictures: Path, group: Group, comparison: Comparison, data: Path) -> Content:
    """Return a picture of a frame's way from image to steering, and the graphs of its drive in 3D.

    The picture is also written to the folder `pictures`. `data` is the folder of all stages. The
    result is empty if files of the stages are missing.
    """
    path = pictures / "chain.png"
    caption, views = figures.draw_chain(path, group, comparison, data)
    if not views:
        return []
    space = plots.to_html(plots.in_space(views), "space", "min(32rem, 105vw)")
    return [picture(path, caption), Figure(_SPACE, space)]


def test_drives(pictures: Path, group: Group, comparison: Comparison, ingest: Path) -> Content:
    """Return plots and pictures of the best, the median and the worst test drive.

    A plot shows values over time. A picture shows the paths at the largest error, and is also
    written to the folder `pictures`. `ingest` is the folder of stage ingest.
    """
    best = comparison.by_error[0]
    count = group.first_seeds["drive"].nunique()
    first = "The only test drive"
    if count > 1:
        first = f"Of {count} test drives, the best, the median and the worst by error of {best}"
    hint = "Drag to zoom, double-click to reset, click the legend to hide."
    content: list[str | Figure] = [f"{first}: predictions of the first seed. {hint}"]

    # The plots of all drives have the same vertical axis.
    drives = group.typical_drives(best)
    shown = group.first_seeds[group.first_seeds["drive"].isin(drives)]
    values = shown[["shown_true", "shown_predicted"]].to_numpy()
    limit = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
    captions = figures.draw_errors(pictures, comparison, group, ingest)
    for drive, rank in drives.items():
        rows = shown[shown["drive"] == drive]
        plot = plots.over_time(rows, comparison, limit)
        name = f"{group.key}-{rank}"
        caption = f"The {rank} drive, {drive}: {comparison.quantity.shown_title} over time"
        content.append(Figure(caption, plots.to_html(plot, name)))
        if name in captions:
            content.append(picture(pictures / f"{name}.png", captions[name]))
    return content


def learning(train: Path, models: Sequence[str]) -> Content:
    """Return a plot of the learning curves of models. `train` is the folder of stage train."""
    curves = {}
    for model in models:
        for path in sorted((train / model).rglob("curve.csv")):
            network = ".".join(path.relative_to(train).parts[:-1])  # MODEL.seed-N
            curves[network] = pd.read_csv(path)
    if not curves:
        return []
    return [Figure(_LEARNING, plots.to_html(plots.learning(curves), "learning"))]
