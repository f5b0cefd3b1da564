"""Write the page: one HTML file that needs no other file and no network, from page.html.j2."""

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from pipeline.report import plots
from pipeline.report.figures import Figures
from pipeline.report.results import Group
from pipeline.report.tables import Table

_LEARNING = "Each line is a seed: nmse on the validation drives; dotted, without these, the training loss."
_SPACE = "Points and edges of the same drive in 3D. Drag to turn, move the slider, click a class to hide it."


class Figure(NamedTuple):
    caption: str
    html: str


Content = Sequence[str | Table | Figure]


def write_page(
    path: Path, story: list[str], groups: list[Group], tables: list[Table], perception: Content, figures: Figures
) -> None:
    """Write the page beside folders figures and learning. `perception`: sources of the encoder's weights; tables."""
    captions, views = figures
    pictures = {name: _picture(path.parent / f"figures/{name}.png", caption) for name, caption in captions.items()}
    curves = {file.stem: pd.read_csv(file) for file in sorted((path.parent / "learning").glob("*.csv"))}
    look = plots.styles(groups)
    learning = [Figure(_LEARNING, plots.to_html(plots.learning(curves, look), "learning"))] if curves else []
    space = [Figure(_SPACE, plots.to_html(plots.in_space(views), "space", "min(32rem, 105vw)"))] if views else []
    first, paper = (tuple(table for table in tables if table.title.startswith(start)) for start in ("Res", "The paper"))
    sections: dict[str, Content] = {
        "From image to graph": [*(pictures[name] for name in pictures if name == "chain"), *space],
        "Results": first,
        "The paper": paper,
        **{f"Test drives: {group.title}": _test_drives(group, pictures, look) for group in groups},
        "Learning curves": learning,
        "Models in detail": [table for table in tables if table not in (*first, *paper)],
        "Depth, classes and motion": perception,
    }
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    best = groups[0].by_error[0] if groups else None
    html = environment.get_template("page.html.j2").render(
        story=story,
        sections={title: content for title, content in sections.items() if content},
        change=best and f"models.{best['model']}.temporal={'ncp' if best['entry']['temporal'] == 'lstm' else 'lstm'}",
        plotly=get_plotlyjs(),
    )
    path.write_text(html, encoding="utf-8")


def _picture(path: Path, caption: str) -> Figure:
    png = base64.b64encode(path.read_bytes()).decode("ascii")
    return Figure(caption, Markup('<img src="data:image/png;base64,{}" alt="{}" loading="lazy">').format(png, caption))


def _test_drives(group: Group, pictures: dict[str, Figure], look: plots.Styles) -> Content:
    angle = " The angle is the turn of the path over all ranges." if any(group.labels.values()) else ""
    model, drives = group.by_error[0]["model"], group.predictions["drive"].nunique()
    content: list[str | Figure] = [
        f"Of {drives} drives the best, the median and the worst by mean squared error of {model}: predictions of the "
        f"first seed.{angle} Drag to zoom, double-click to reset, click the legend to hide."
    ]
    for drive, rank in group.typical_drives.items():
        rows = group.predictions[group.predictions["drive"] == drive]
        plot = plots.to_html(plots.over_time(rows, look), f"{group.key}-{rank}")
        content.append(Figure(f"The {rank} drive, {drive}: {group.title} over time", plot))
        content += [pictures[name] for name in pictures if name == f"{group.key}-{rank}"]
    return content
