"""Write the values of published runs, docs/results, into the pages.

    python -m docs.make_results collect data/report/roads.json    # adds a run, or replaces it
    python -m docs.make_results collect data/report/results.json demo   # the same after make demo
    python -m docs.make_results render

A value stands before a comment with its key, as in 0.064<!-- roads/angle-0/sa-gnn-ncp -->. This
value is an nmse. For another part of the entry, its name follows the key, as in
1.44<!-- roads/angle-0/sa-gnn-ncp:mae -->. A table of the report is written between a comment
with its run, group, name and columns, and the comment <!-- end -->.
"""

import json
import re
from pathlib import Path
from typing import Annotated

import typer

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.evaluate.statistics import interval_text
from pipeline.report import tables
from pipeline.report.origin import origin
from pipeline.report.summary import Comparison, Results

DOCS = Path(__file__).parent
RUNS = DOCS / "results"
PAGES = (DOCS.parent / "README.md", DOCS / "results.md")
# Name of a table in a page → function that makes it.
TABLES = {"claims": tables.claims_table, "results": tables.results_table}
# A table in a page. The comment before it has RUN GROUP NAME: COLUMN; COLUMN.
TABLE = re.compile(r"(<!-- table: (\S+) (\S+) (\w+): ([^\n]*) -->\n).*?(\n<!-- end -->)", re.DOTALL)
# A value in a page: a number, the interval of a difference in brackets, and a comment with RUN/KEY
# or RUN/KEY:PART.
VALUE = re.compile(r"[−+]?\d+\.\d+(?: \([^()]*\))?(<!-- (\w+)/([^:>]+?)(?::(\w+))? -->)")
# Part of an entry → decimal places of its value.
PLACES = {"value": 3, "mae": 2}
# Decimal places of the demo's values, which every reader computes again: the third depends on the
# processor.
DEMO_PLACES = 2


def collect(
    source: Path, name: Annotated[str, typer.Argument(help="default: the preset's")] = ""
) -> None:
    """Copy the results of a run to docs/results/NAME.json, and render the pages.

    `source` is data/report/PRESET.json, or results.json of the checkout. Raises InputError if it is
    not the result of committed code.
    """
    run = store.read_json(source, stage="report")
    if "results" not in run:
        run = {"preset": name, **origin(), "results": run}
    if not re.fullmatch("[0-9a-f]+", run["revision"]):
        problem = f"its code is not committed (revision {run['revision']})"
        raise InputError(problem, source, "Commit the code and repeat the run")
    values = [f"{json.dumps(key)}: {json.dumps(entry)}" for key, entry in run["results"].items()]
    del run["results"]
    text = f'{json.dumps(run)[:-1]}, "results": {{\n' + ",\n".join(values) + "\n}}\n"
    store.write_text(RUNS / f"{name or run['preset']}.json", text)
    render()


def render() -> None:
    """Write values and tables into the pages."""
    for page, content in pages(read_results()).items():
        store.write_text(page, content)


def read_results() -> dict[str, Results]:
    """Return preset → results of its runs. If runs have the same key, the later run counts."""
    runs = [json.loads(path.read_text(encoding="utf-8")) for path in RUNS.glob("*.json")]
    presets: dict[str, Results] = {}
    for run in sorted(runs, key=lambda run: str(run["date"])):
        presets.setdefault(run["preset"], {}).update(run["results"])
    return presets


def pages(runs: dict[str, Results]) -> dict[Path, str]:
    """Return the path and the text of each page, with values and tables of `runs`."""

    def value(match: re.Match[str]) -> str:
        comment, run, key, part = match.groups()
        part = part or "value"
        entry = runs[run][key]
        places = DEMO_PLACES if run == "demo" else PLACES[part]
        if " - " in key:
            bounds = interval_text(entry["interval"], f"+.{places}f")
            return with_minus(f"{entry['value']:+.{places}f} ({bounds})") + comment
        return f"{entry[part]:.{places}f}{comment}"

    def table(match: re.Match[str]) -> str:
        start, run, group, name, columns, end = match.groups()
        full = TABLES[name](Comparison(runs[run], group))
        heads = columns.split("; ")
        rows = []
        for row in full.rows:
            rows.append({head: row.get(head, tables.NONE) for head in heads})
        return start + with_minus(tables.Table("", rows).markdown()) + end

    texts = {page: page.read_text(encoding="utf-8") for page in PAGES}
    return {page: VALUE.sub(value, TABLE.sub(table, text)) for page, text in texts.items()}


def with_minus(text: str) -> str:
    """Return a text with typographic minus signs before numbers."""
    return re.sub(r"-(?=\d\.)", "−", text)


if __name__ == "__main__":
    console.run(collect, render)
