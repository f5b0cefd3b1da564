"""Write the page: one HTML file that needs no other file and no network, from page.html.j2."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from pipeline.report import plots
from pipeline.report.dvc_files import load_curves
from pipeline.report.results import Group
from pipeline.report.tables import Table


class Plot(NamedTuple):
    caption: str
    figure: plots.Plot


class Picture(NamedTuple):
    caption: str
    png: str  # in base64


Content = Sequence[str | Table | Plot | Picture]


def write_page(
    path: Path,
    story: Sequence[str],
    groups: Sequence[Group],
    tables: Sequence[Table],
    perception: Sequence[Table],
    figures: Mapping[str, str],
    data: Path,
) -> None:
    """Write the page.

    Args:
        path: the HTML file; the files of `figures` are in folder figures beside it.
        story: sentences about the results.
        groups: all results.
        tables: of models and baselines, the first ones with a row per model and baseline of each group.
        perception: tables of depth, classes and motion.
        figures: name of a PNG file without suffix → caption; the chain is shown first.
        data: holds a folder per stage; folders may be missing.
    """
    pictures = {
        name: Picture(caption, base64.b64encode((path.parent / f"figures/{name}.png").read_bytes()).decode("ascii"))
        for name, caption in figures.items()
    }
    chain, look = pictures.pop("chain", None), plots.styles(groups)
    sections: dict[str, Content] = {
        "Results": tables[: len(groups)],
        **{f"Test drives: {group.title}": _test_drives(group, look) for group in groups},
        "Largest errors": [*pictures.values()],
        "Learning curves": _learning(groups, look, data / "train"),
        "Models in detail": tables[len(groups) :],
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
    path.write_text(html, encoding="utf-8")


def _test_drives(group: Group, look: plots.Styles) -> Content:
    predictions = group.predictions[group.predictions["run"] == ""]
    drives, count = group.worst_drives(), predictions["drive"].nunique()
    chosen = f" on the {len(drives)} of {count} drives with the largest squared error" if count > len(drives) else ""
    shown = [(drive, predictions[predictions["drive"] == drive]) for drive in drives]
    angle = " The angle is the turn of the path over all ranges." if any(group.labels.values()) else ""
    content: list[str | Plot] = [
        f"Predictions of the first seed{chosen}.{angle} Drag to zoom, double-click to reset, click the legend to hide "
        "a line.",
        *(Plot(f"{drive}: {group.title} over time", plots.over_time(table, look)) for drive, table in shown),
    ]
    for column, label in group.labels.items():
        caption = f"Error by curvature of the road{label and f', {label} ahead'}, mean over seeds"
        content.append(Plot(caption, plots.by_curvature(group.models, column, look)))
    return content


def _learning(groups: Sequence[Group], look: plots.Styles, train: Path) -> Content:
    models = [row["model"] for group in groups for row in group.models]
    curves = {model: load_curves(train / model) for model in models}
    first = {model: next(iter(runs.values())) for model, runs in curves.items() if runs}
    caption = "Training loss (dotted) and validation nmse of each model's first network"
    return [Plot(caption, plots.learning(first, look))] if first else []
