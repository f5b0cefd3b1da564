"""Write the page: one HTML file that needs no other file and no network, from page.html.j2."""

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from pipeline.report import plots
from pipeline.report.figures import Figures
from pipeline.report.results import Group, Row
from pipeline.report.summary import Results
from pipeline.report.tables import DEFINITIONS, SteeringTables, Table

_LEARNING = (
    "Each line is a seed: nmse on the validation drives; dotted, without these, the training loss."
)
_ERRORS = "nmse on the test drives, with its 95 % interval; 0 is perfect, 1 is useless"
_SPACE = (
    "Points and edges of the same drive in 3D. Drag to turn, move the slider, click a class to "
    "hide it."
)


class Figure(NamedTuple):
    caption: str
    html: str


Content = Sequence[str | Table | Figure]


class Story(NamedTuple):
    """What stands above the sections."""

    headline: str
    sentences: Sequence[str]
    doubts: Sequence[str]
    origin: str  # revision, date and machine


def write_page(
    path: Path,
    story: Story,
    groups: Sequence[Group],
    figures: Results,
    tables: SteeringTables,
    perception: Content,
    pictures: Figures,
) -> None:
    """Write the page beside folders figures and learning. `perception`: sources of the encoder's
    weights; tables.
    """
    captions, views = pictures
    drawn = {
        name: _picture(path.parent / f"figures/{name}.png", caption)
        for name, caption in captions.items()
    }
    curves = {
        file.stem: pd.read_csv(file) for file in sorted((path.parent / "learning").glob("*.csv"))
    }
    look = plots.styles(groups)
    errors = [Figure(f"{_ERRORS}: {group.title}.", _errors(group, figures)) for group in groups]
    learning = (
        [Figure(_LEARNING, plots.to_html(plots.learning(curves, look), "learning"))]
        if curves
        else []
    )
    space = (
        [Figure(_SPACE, plots.to_html(plots.in_space(views), "space", "min(32rem, 105vw)"))]
        if views
        else []
    )
    sections: dict[str, Content] = {
        "Errors": errors,
        "From image to graph": [*(drawn[name] for name in drawn if name == "chain"), *space],
        "Results": tables.results,
        "The paper": tables.paper,
        **{f"Test drives: {group.title}": _test_drives(group, drawn, look) for group in groups},
        "Learning curves": learning,
        "Models in detail": tables.details,
        "Depth, classes and motion": perception,
        "Definitions": [f"{word}: {meaning}" for word, meaning in DEFINITIONS.items()]
        if groups
        else [],
    }
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    html = environment.get_template("page.html.j2").render(
        story=story,
        sections={title: content for title, content in sections.items() if content},
        change=_swap(groups[0].by_error[0]) if groups else "",
        plotly=get_plotlyjs(),
    )
    path.write_text(html, encoding="utf-8")


def _swap(row: Row) -> str:
    """Return a change of settings that trains a model with another network of the sequence."""
    temporal = "ncp" if row["entry"]["temporal"] == "lstm" else "lstm"
    return f"models.{row['model']}.temporal={temporal}"


def _errors(group: Group, figures: Results) -> str:
    height = f"{4 + 2 * len(group.predicted)}rem"
    return plots.to_html(plots.errors(group, figures), f"{group.key}-errors", height)


def _picture(path: Path, caption: str) -> Figure:
    png = base64.b64encode(path.read_bytes()).decode("ascii")
    return Figure(
        caption,
        Markup('<img src="data:image/png;base64,{}" alt="{}" loading="lazy">').format(png, caption),
    )


def _test_drives(group: Group, pictures: dict[str, Figure], look: plots.Styles) -> Content:
    """Return the angles over time of the best, the median and the worst drive, on one axis, and
    their pictures.
    """
    drives = group.predictions["drive"].nunique()
    first = "The only test drive"
    if drives > 1:
        first = (
            f"Of {drives} test drives, the best, the median and the worst by error of "
            f"{group.by_error[0]['model']}"
        )
    turn = (
        " The angle is the turn of the path over all ranges." if any(group.labels.values()) else ""
    )
    hint = "Drag to zoom, double-click to reset, click the legend to hide."
    content: list[str | Figure] = [f"{first}: predictions of the first seed.{turn} {hint}"]
    typical = group.predictions[group.predictions["drive"].isin(group.typical_drives)]
    limit_deg = float(
        np.nanmax(np.abs(typical[["true_deg", "predicted_deg"]].to_numpy()), initial=1.0)
    )
    for drive, rank in group.typical_drives.items():
        rows = group.predictions[group.predictions["drive"] == drive]
        plot = plots.to_html(plots.over_time(rows, look, limit_deg), f"{group.key}-{rank}")
        content.append(Figure(f"The {rank} drive, {drive}: {group.title} over time", plot))
        content += [pictures[name] for name in pictures if name == f"{group.key}-{rank}"]
    return content
