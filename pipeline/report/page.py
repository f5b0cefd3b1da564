"""Write the page: one HTML file that needs no other file and no network, from page.html.j2."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import yaml
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from pipeline.evaluate.own_metrics import METRICS
from pipeline.report import drawings, tables
from pipeline.report.drawings import Picture
from pipeline.report.section import Section, without_dashes
from pipeline.report.values import Task, title_of

# A paragraph, a table or a picture, which is None if it was not drawn.
Content = Sequence[str | Section | Picture | None]


@dataclass
class Page:
    """The content of the page from top to bottom."""

    sentences: Sequence[str]  # the verdict, its interval, and more
    doubts: Sequence[str]
    picture: Picture | None  # what stands below the sentences
    results: Content
    details: dict[str, Content]  # title → content that is folded
    origin: Mapping[str, str]  # revision, date, machine; preset and duration if a preset runs
    settings: Mapping[str, Any]  # those of the preset, if one runs


def list_results(folder: Path, values: pd.DataFrame, tasks: Sequence[Task]) -> Content:
    """Return a table and a chart of the errors of each task, and the paper's claims."""
    content: list[str | Section | Picture | None] = []
    for task in tasks:
        section = tables.results_table(values, task.name, page=True)
        section = section._replace(table=section.table.filter(regex=_match_errors()))
        content += [section, drawings.draw_errors(folder, task.name, values.loc[task.name])]
        claims = tables.claims_table(values, task.name)
        if claims.table.size:
            content.append(claims)
    return content


def _match_errors() -> str:
    """Return a regular expression for the columns of errors in tables of results."""
    return f"^({'|'.join(['error', 'nmse', 'MAE', *METRICS])})"


def list_details(
    folder: Path, values: pd.DataFrame, tasks: Sequence[Task], data: Path
) -> dict[str, Content]:
    """Return what is folded: title → tables and pictures, which are written to `folder`.

    `data` is the folder of all stages.
    """
    content: dict[str, Content] = {}
    for task in tasks:
        table = values.loc[task.name]
        title = title_of(task.name)
        section = tables.results_table(values, task.name, page=True)
        others = section.table.columns[~section.table.columns.str.match(_match_errors())]
        content[f"nmse by range: {title}"] = tables.nmse_tables(values, task.name, page=True)
        content[f"Differences and sizes: {title}"] = [
            tables.differences_table(values, task.name, page=True),
            Section("Sizes", without_dashes(section.table[others])),
        ]
        content[f"Test drives: {title}"] = [drawings.draw_over_time(folder, task, table)]
    for task in tasks[:1]:
        chain = drawings.draw_chain(folder, task, values.loc[task.name], data)
        content["From image to graph"] = [chain]
        content["Learning curves"] = [drawings.draw_learning(folder, values, data / "train")]
        content["Models"] = [tables.models_table(tasks)]
    return content


def text_of(page: Page) -> str:
    """Return the words of a page, without its settings and what is drawn in its pictures."""
    parts = [*page.sentences, *page.doubts]
    items = [page.picture, *page.results]
    for title, content in page.details.items():
        parts.append(title)
        items += content
    for item in items:
        if isinstance(item, Section):
            parts.append(item.markdown())
        elif isinstance(item, Picture):
            parts.append(item.caption)
        elif item is not None:
            parts.append(item)
    return "\n".join(parts)


def write_page(path: Path, page: Page) -> None:
    """Write a page, which ends with the origin of its results."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    environment.filters["marked"] = mark_names
    html = environment.get_template("page.html.j2").render(
        page=page,
        settings=yaml.safe_dump(dict(page.settings), allow_unicode=True, sort_keys=False),
        next=next_step(page.origin.get("preset")),
    )
    path.write_text(html, encoding="utf-8")


def next_step(preset: str | None) -> str:
    """Return what a reader of the page may do next."""
    if preset:
        return f"edit presets/{preset}.yaml, and run make {preset}, which trains only what changed"
    return "add a network to models in params.yaml, and run dvc repro (README, Add yours)"


def mark_names(text: str) -> Markup:
    """Return a text as HTML, with names marked and what follows a line break in small letters."""
    html = str(escape(text))
    html = re.sub("`(.+?)`", r"<code>\1</code>", html)
    html = re.sub(r"\*(\w+)\*", r"<em>\1</em>", html)
    html = re.sub(r"\n(.*)", r"<br><small>\1</small>", html)
    return Markup(html)
