"""Write the values of published runs, docs/results, into the pages.

    python -m docs.make_results collect data/report/roads.json    # adds a run, or replaces it
    python -m docs.make_results collect data/report/results.json demo   # the same after make demo
    python -m docs.make_results render

A value stands before a comment with its key, as in 0.064<!-- roads/angle-0/sa-gnn-ncp -->. This
value is an nmse. For another column, its name follows the key, as in
1.73<!-- demo/path-0/at 20 m/path:error -->. Revision, date and machine of a run stand in brackets
before a comment with its name alone. A table of the report is written between a comment with its
run, task, name and columns, and the comment <!-- end -->.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.jobs import console
from pipeline.jobs.origin import describe_origin

from pipeline.base import store
from pipeline.base.checkout import ROOT
from pipeline.base.errors import InputError
from pipeline.base.params import read_yaml
from pipeline.report import number_text, tables
from pipeline.report.section import to_markdown
from pipeline.report.values import from_json

# Key → values of a row, as in results.json.
Rows = dict[str, dict[str, Any]]

DOCS = Path(__file__).parent
RUNS = DOCS / "results"
PAGES = (DOCS.parent / "README.md", DOCS / "results.md")
# Name of a table in a page → function that makes it.
TABLES = {"claims": tables.claims_table, "results": tables.results_table}
# A table in a page. The comment before it has RUN TASK NAME: COLUMN; COLUMN.
TABLE = re.compile(r"(<!-- table: (\S+) (\S+) (\w+): ([^\n]*) -->\n).*?(\n<!-- end -->)", re.DOTALL)
# A value in a page: a number, the interval of a difference in brackets, and a comment with RUN/KEY
# or RUN/KEY:COLUMN.
VALUE = re.compile(r"[−+]?\d+\.\d+(?: \([^()]*\))?(<!-- (\w+)/([^:>]+?)(?::(\w+))? -->)")
# The origin of a run in a page: brackets, and a comment with RUN.
ORIGIN = re.compile(r"\([^()]*\)(<!-- (\w+) -->)")
# Column → decimal places of its values.
PLACES = {"nmse": 3, "value": 3, "error": 2, "mae": 2}


def collect(
    source: Path, name: Annotated[str, typer.Argument(help="default: the preset's")] = ""
) -> None:
    """Copy the results of a run to docs/results/NAME.json, and render the pages.

    `source` is data/report/PRESET.json, or results.json of the checkout, whose params.yaml is then
    copied, too. Raises InputError if it is not the result of committed code.
    """
    run = store.read_json(source, stage="report")
    if "results" not in run:
        settings = read_yaml(ROOT / "params.yaml")
        run = {"preset": name, **describe_origin(), "settings": settings, "results": run}
    for key in ("frames", "scores"):
        run["results"].pop(key, None)
    if not re.fullmatch("[0-9a-f]+", run["revision"]):
        problem = f"its code is not committed (revision {run['revision']})"
        raise InputError(problem, source, "Commit the code and repeat the run")
    values = [f"{json.dumps(key)}: {json.dumps(row)}" for key, row in run["results"].items()]
    del run["results"]
    text = f'{json.dumps(run)[:-1]}, "results": {{\n' + ",\n".join(values) + "\n}}\n"
    store.write_text(RUNS / f"{name or run['preset']}.json", text)
    render()


def render() -> None:
    """Write values and tables into the pages."""
    for page, content in pages(read_runs()).items():
        store.write_text(page, content)


def read_runs() -> list[dict[str, Any]]:
    """Return the runs from the earliest to the latest, each with its preset, origin and results."""
    runs = [json.loads(path.read_text(encoding="utf-8")) for path in RUNS.glob("*.json")]
    return sorted(runs, key=lambda run: str(run["date"]))


def pages(runs: Sequence[Mapping[str, Any]]) -> dict[Path, str]:
    """Return the path and the text of each page, with values and tables of `runs`.

    If runs have the same key, the later run counts.
    """
    rows: dict[str, Rows] = {}
    origins = {}
    for run in runs:
        rows.setdefault(run["preset"], {}).update(run["results"])
        facts = [str(run[key]) for key in ("revision", "date", "machine") if key in run]
        origins[run["preset"]] = f"revision {', '.join(facts)}"

    def value(match: re.Match[str]) -> str:
        comment, run, key, column = match.groups()
        column = column or "nmse"
        row = rows[run][key]
        form = f"z.{PLACES[column]}f"
        if " - " in key:
            bounds = number_text.bounds_text(row, f"+{form}")
            return f"{number_text.value_text(row[column], f'+{form}')} ({bounds}){comment}"
        return f"{row[column]:{form}}{comment}"

    def table(match: re.Match[str]) -> str:
        start, run, task, name, columns, end = match.groups()
        full = TABLES[name](from_json(rows[run]), task).table.reset_index()
        heads = columns.split("; ")
        return start + to_markdown(full[heads].set_index(heads[0])) + end

    def origin(match: re.Match[str]) -> str:
        comment, run = match.groups()
        return f"({origins[run]}){comment}"

    texts = {}
    for page in PAGES:
        text = TABLE.sub(table, page.read_text(encoding="utf-8"))
        texts[page] = ORIGIN.sub(origin, VALUE.sub(value, text))
    return texts


if __name__ == "__main__":
    console.run(collect, render)
