"""Render the tables of the pages from the runs in docs/results.

    python -m docs.make_results collect data/report/roads.json    # adds a run of `make roads`, or
    replaces it python -m docs.make_results render

A key is PRESET/KEY, with keys as in pipeline/report/summary.py: roads/angle-10/motion-10.
measured.json has figures of runs of earlier revisions, each with its revision.
"""

import json
import re
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.report.paper import CLAIMS, PAPER
from pipeline.report.results import NO_LEARNING
from pipeline.report.summary import Results
from pipeline.report.tables import NONE, Table, claim_cells, number

DOCS = Path(__file__).parent
RUNS = DOCS / "results"
PAGES = (DOCS.parent / "README.md", DOCS / "results.md", DOCS / "log.md")
TABLE = re.compile(r"(<!-- table: (\w+) -->).*?(<!-- end -->)", re.DOTALL)
BLIND = "motion only"
ROWS = yaml.safe_load((DOCS / "tables.yaml").read_text(encoding="utf-8"))


def collect(
    source: Path, name: Annotated[str, typer.Argument(help="default: the preset's")] = ""
) -> None:
    """Copy data/report/PRESET.json of a run to docs/results/NAME.json, and render the pages. Raises
    InputError.
    """
    run = store.read_json(source, stage="report")
    if not re.fullmatch("[0-9a-f]+", run["revision"]):
        problem = f"its code is not committed (revision {run['revision']})"
        raise InputError(problem, source, "Commit the code and repeat the run")
    figures = ",\n".join(
        f"{json.dumps(key)}: {json.dumps(entry)}" for key, entry in run.pop("results").items()
    )
    path = RUNS / f"{name or run['preset']}.json"
    store.write_text(path, f'{json.dumps(run)[:-1]}, "results": {{\n{figures}\n}}}}\n')
    render()


def render() -> None:
    """Write the tables into the pages."""
    for page, content in pages(read()).items():
        store.write_text(page, content)


def read() -> Results:
    """Return PRESET/KEY → figure of all runs; a later run of a preset takes precedence."""
    runs = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(RUNS.glob("*.json"))]
    figures: Results = {}
    for run in sorted(runs, key=lambda run: str(run["date"])):
        figures |= {f"{run['preset']}/{key}": entry for key, entry in run["results"].items()}
    return figures


def pages(results: Results) -> dict[Path, str]:
    """Return the pages with their tables."""

    def table(found: re.Match[str]) -> str:
        head, *rows = TABLES[found[2]](results)
        rule = ["---", *["--:"] * (len(head) - 2), "---"]
        return "\n".join(
            [found[1], *(f"| {' | '.join(row)} |" for row in (head, rule, *rows)), found[3]]
        )

    return {page: TABLE.sub(table, page.read_text(encoding="utf-8")) for page in PAGES}


def get(results: Results, key: str, part: str = "figure") -> Any:
    """Return a part of a figure, None if it is unknown."""
    return results.get(key, {}).get(part)


def text(results: Results, key: str, part: str = "figure", form: str = ".3f") -> str:
    """Return a figure or its interval; a dash if it is unknown."""
    value = get(results, key, part)
    values = value if isinstance(value, list) else [value]
    return " to ".join(number(each, form) for each in values).replace("-", "−")


def difference(results: Results, key: str) -> str:
    """Return a paired difference with its interval."""
    return (
        f"{text(results, key, form='+.3f')} ({text(results, key, 'interval', '+.3f')})"
        if key in results
        else NONE
    )


def claims(results: Results) -> list[list[str]]:
    """Return a row per claim of the paper."""
    rows = []
    for claim in CLAIMS:
        if f"table2/angle-0/{claim.model} - {claim.rival}" in results:
            rows.append(claim_cells(claim, "table2/angle-0", results))
    table = Table("", rows)
    return [
        table.heads,
        *([re.sub(r"-(?=\d\.)", "−", cell) for cell in row] for row in table.cells),
    ]


def verdicts(results: Results) -> list[list[str]]:
    """Return claim, verdict, and the nmse of both networks."""
    table = [["the paper's claim", "verdict (95 %)", "nmse"]]
    for (statement, verdict, *_), claim in zip(claims(results)[1:], CLAIMS, strict=True):
        errors = (
            f"{name} {text(results, f'table2/angle-0/{name}')}"
            for name in (claim.model, claim.rival)
        )
        table.append([statement, verdict, ", ".join(errors)])
    return table


def works(results: Results) -> list[list[str]]:
    """Return a row per task that README names."""
    return [["task", "nmse", "to compare with"], *filled(results, "works")]


def filled(results: Results, name: str) -> list[list[str]]:
    """Return rows of docs/tables.yaml with the figures whose keys they have in braces."""
    return [
        [re.sub(r"\{(.*?)\}", lambda key: text(results, key[1]), cell) for cell in row]
        for row in ROWS[name]
    ]


def beyond(results: Results) -> list[list[str]]:
    """Return a row per question beyond the paper, and rows of measured motion."""
    heads = ["nmse on unseen drives", "without learning", BLIND, "with the scene", "mean error, °"]
    rows = [[*heads, "does the scene help?"]]
    for question, group, kind in ROWS["beyond"]:
        model, *controls = ROWS["models"].get(kind, [kind])
        key = f"{group}/{model}"
        best = best_baseline(results, group)
        blind = next((name for name in controls if "blind" in name), "")
        nmse = [text(results, f"{group}/{name}") for name in (best, blind, model)]
        degrees = text(results, key, "mae_deg", ".2f")
        rows.append([question, *nmse, degrees, shown(results, key, [best, *controls])])
    return [*rows, *filled(results, "measured")]


def best_baseline(results: Results, group: str) -> str:
    """Return the baseline without learning that has the smallest error."""
    errors = {name: get(results, f"{group}/{name}") for name in NO_LEARNING}
    return min((name for name in errors if errors[name] is not None), key=lambda name: errors[name])


def shown(results: Results, model: str, rivals: list[str]) -> str:
    """Return the difference to the rival whose interval has the greatest upper bound, and what it
    shows.
    """
    bounds = {name: get(results, f"{model} - {name}", "interval") for name in rivals}
    upper = {name: interval[1] for name, interval in bounds.items() if interval}
    if not upper:
        return NONE
    least = max(upper, key=lambda name: upper[name])
    answer = get(results, f"{model} - {least}", "verdict")
    answer = "open" if answer == "better" and len(upper) < len(rivals) else answer
    words = (
        "no learning" if least in NO_LEARNING else BLIND if "blind" in least else "another scene"
    )
    return f"{answer}, {difference(results, f'{model} - {least}')} to {words}"


def table2(results: Results) -> list[list[str]]:
    """Return a row per network, first the paper's, beside the paper's MSE."""
    heads = [
        "network",
        "paper: train MSE",
        "test",
        "here: test, rad²",
        "nmse",
        "95 % interval",
        "sa-gnn-ncp − it",
    ]
    names = re.findall(r"^table2/angle-0/(\S+)$", "\n".join(results), re.MULTILINE)
    rows = []
    for name in (*PAPER, *(name for name in names if name not in (*PAPER, *NO_LEARNING))):
        key, paper = f"table2/angle-0/{name}", PAPER.get(name)
        published = [
            number(paper and paper.train_mse, ".3f"),
            number(paper and paper.test_mse, ".3f"),
        ]
        here = [
            text(results, key, "mse", ".5f"),
            text(results, key),
            text(results, key, "interval"),
        ]
        rows.append(
            [name, *published, *here, difference(results, f"table2/angle-0/sa-gnn-ncp - {name}")]
        )
    return [heads, *rows]


def coverage(results: Results) -> list[list[str]]:
    """Return how often intervals contain the true difference."""
    keys = [key.split("/")[1:] for key in results if key.startswith("coverage/")]
    sets, worlds = (dict.fromkeys(names) for names in zip(*keys, strict=True))
    tested = sorted(sets, key=lambda name: int(name.split()[0]))
    rows = [
        [name, *(text(results, f"coverage/{name}/{world}", form=".1%") for world in worlds)]
        for name in tested
    ]
    return [["test set", *worlds], *rows]


TABLES = {table.__name__: table for table in (works, verdicts, claims, beyond, table2, coverage)}

if __name__ == "__main__":
    console.run(collect, render)
