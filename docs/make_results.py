"""Collect figures of runs in docs/results.json, and render the tables of the pages and docs/roads.png from it.

    python -m docs.make_results collect runs/roads roads    # a finished run and its preset, or a JSON file of figures
    python -m docs.make_results render

A key is PRESET/GROUP/ROW: roads/angle-10/motion-10 or, of a range, roads/path-0/10-20 m/path. A row is a model, a
baseline, or "A - B", their paired difference in nmse. PRESET/val/… are validation errors.
"""

import json
import re
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import typer
from matplotlib.figure import Figure

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.base.params import load
from pipeline.evaluate import errors
from pipeline.report import street_view
from pipeline.report.paper import PAPER
from pipeline.report.results import NO_LEARNING, load_groups, validation_nmse
from pipeline.report.tables import NONE, number
from pipeline.settings.evaluate import Evaluate
from pipeline.settings.train import Train
from presets.run import revision

DOCS = Path(__file__).parent
PAGES = (DOCS.parent / "README.md", DOCS / "results.md", DOCS / "paper.md")
TABLE = re.compile(r"(<!-- table: (\w+) -->).*?(<!-- end -->)", re.DOTALL)
OURS = "sa-gnn-lstm"  # our best network of images only, chosen on validation drives
BLIND = "motion only"
REAL = "real/path-0/10-20 m"
CLAIMS = {"keep-100": "all edges", "lambda-0": "no classes", "sa-gnn-lstm": "an LSTM"}  # sa-gnn-ncp but for one setting
QUESTIONS = {  # has the model PRESET/GROUP/ROW a smaller error than these, and but for claims than the best baseline?
    "angle now, the paper's network, 48 rendered roads": ("demo/angle-0/sa-gnn-ncp",),
    "angle now, the paper's network, 240 rendered roads": ("roads/angle-0/sa-gnn-ncp",),
    "angle now, our best network, 48 rendered roads": (f"demo/angle-0/{OURS}",),
    "angle now, our best network, 240 rendered roads": (f"roads/angle-0/{OURS}",),
    "does pruning help": ("table2/angle-0/sa-gnn-ncp", "keep-100"),
    "do semantics help": ("table2/angle-0/sa-gnn-ncp", "lambda-0"),
    "angle a second ahead, 240 rendered roads": ("roads/angle-10/motion-10", "motion-10-blind", "motion-10-another"),
    "path 10 to 20 m ahead, 240 rendered roads": ("roads/path-0/10-20 m/path", "path-blind", "path-another"),
    "path 10 to 20 m ahead, six real drives": (f"{REAL}/path-others", "path-blind-others", "path-another-others"),
    "… trained on rendered roads before": (f"{REAL}/path-then", "path-blind-others", "path-another-then"),
}
STEPS = 1200  # epochs × roads of the study of the number of roads; networks with more steps are stars
LINES = {  # model: label, format
    "motion-10": ("a second ahead", "b-"),
    "motion-10-blind": ("… without the scene", "b--"),
    "path": ("path ahead, mean of the ranges to 30 m", "g-"),
    "path-blind": ("… without the scene", "g--"),
    "sa-gnn-ncp": ("current frame, without motion", "r-"),
}
Results = dict[str, dict[str, Any]]


def collect(source: Path, preset: str) -> None:
    """Replace a preset's figures, in the groups that a run or a JSON file (key → figure) has; then render."""
    copied = source / "revision"
    made = copied.read_text("ascii") if copied.is_file() else revision(source if source.is_dir() else Path())
    if not made or made.endswith("dirty"):
        raise InputError("its code is not committed", source, "Commit the code and repeat the run")
    new = store.read_json(source, stage=preset) if source.is_file() else figures_of(source)
    origin = {"preset": preset, "revision": made, "date": str(date.today())}
    results = merged(read(), {f"{preset}/{key}": values | origin for key, values in new.items()})
    lines = (f"{json.dumps(key)}: {json.dumps(results[key])}" for key in sorted(results))
    (DOCS / "results.json").write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    render()


def merged(results: Results, new: Results) -> Results:
    """Return figures with all of the groups that `new` has replaced; but of validation errors, each one."""
    groups = {tuple(key.split("/")[:2]) for key in new if "/val/" not in key}
    return {key: old for key, old in results.items() if tuple(key.split("/")[:2]) not in groups} | new


def render() -> None:
    """Write the tables into the pages, and the plot."""
    for page, content in pages(read()).items():
        page.write_text(content, encoding="utf-8")
    street_view.save(plot(read()), DOCS / "roads.png", dpi=100)


def read() -> Results:
    """Return docs/results.json."""
    return dict(json.loads((DOCS / "results.json").read_text(encoding="utf-8")))


def figures_of(run: Path) -> Results:
    """Return a run's errors, the differences of the models in question to all others, and the errors of motion."""
    params, figures = run / "params.yaml", {}
    folders = {path.parent.name: path.parent for path in sorted((run / "data/evaluate").glob("*/metrics.json"))}
    for group in load_groups(folders, load(Evaluate, params)):
        rows = [name for name in (*folders, *NO_LEARNING) if name in group.predicted]
        for column, label in group.labels.items():
            part = f"{group.key}/{label}".rstrip("/")
            for name in rows:
                scores = group.scores(name, column)
                seeds, mse, frames = scores["by_seed"], scores["mse"], scores["frames"]
                figures[f"{part}/{name}"] = entry(*group.nmse(name, column=column), frames, seeds=seeds, mse=mse)
            for first in {model.rpartition("/")[2] for model, *_ in QUESTIONS.values()}.intersection(rows):
                for other in {*rows} - {first}:
                    value, bounds = group.nmse(first, minus=other, column=column)
                    verdict = group.verdict(bounds, first, other, column)
                    figures[f"{part}/{first} - {other}"] = entry(value, bounds, frames, verdict=verdict)
        for row in (row for row in group.models if validation_nmse(row) < np.inf):
            roads, epochs = row["entry"]["train_drives"] or len(row["drives"]["train"]), load(Train, params).epochs
            key = f"val/{row['model']}/{roads} roads/{epochs} epochs"
            figures[key] = entry(validation_nmse(row), roads=roads, epochs=epochs)
    if (path := run / "data/scores/metrics.json").is_file():
        for kind, splits in store.read_json(path, stage="scores")["motion"].items():
            if splits["test"]:
                figures[f"motion/{kind}"] = entry(splits["test"]["nmse"], frames=splits["test"]["judged"])
    return figures


def entry(
    figure: float | None, interval: list[float] | None = None, frames: int | None = None, **more: Any
) -> dict[str, Any]:
    """Return a figure for results.json, numbers with five digits."""
    values = json.dumps({"figure": figure, "interval": interval, "frames": frames, **more})
    return dict(json.loads(values, parse_float=lambda text: float(f"{float(text):.5g}")))


def pages(results: Results) -> dict[Path, str]:
    """Return the pages with their tables."""

    def table(found: re.Match[str]) -> str:
        head, *rows = TABLES[found[2]](results)
        rule = ["---", *["--:"] * (len(head) - 2), "---"]
        return "\n".join([found[1], *(f"| {' | '.join(row)} |" for row in (head, rule, *rows)), found[3]])

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
    return f"{text(results, key, form='+.3f')} ({text(results, key, 'interval', '+.3f')})" if key in results else NONE


def overview(results: Results) -> list[list[str]]:
    """Return a row per question, and rows of measured motion."""
    rows = [["nmse on unseen drives (1: useless, 0: perfect)", "without learning", BLIND, "with the scene", "shown?"]]
    for question, (model, *rivals) in QUESTIONS.items():
        group, blind = model.rpartition("/")[0], next((name for name in rivals if "blind" in name), "")
        errors = {name: get(results, f"{group}/{name}") for name in NO_LEARNING if not {*rivals} & {*CLAIMS}}
        known = [name for name in errors if errors[name] is not None]
        best = min(known, key=lambda name: errors[name], default="")
        cells = [text(results, key) for key in (f"{group}/{best}", f"{group}/{blind}", model)]
        rows.append([question, *cells, shown(results, model, [name for name in (best, *rivals) if name])])
    teams = min(text(results, f"udacity/{team}") for team in ("autumn", "komanda", "rambo"))
    wheel = text(results, "udacity/steer measure")
    rows.append(["steering wheel, Udacity's test drive, RMSE rad", wheel, NONE, NONE, f"best of three teams: {teams}"])
    motion = sorted({text(results, key) for key in results if key.startswith("real/motion/")})
    measured = " to ".join(dict.fromkeys((motion[0], motion[-1])))
    return [*rows, ["measured motion on real drives, nmse of the angle", measured, NONE, NONE, ""]]


def shown(results: Results, model: str, rivals: list[str]) -> str:
    """Return the difference to the rival whose interval has the greatest upper bound, and what it shows."""
    bounds = {name: get(results, f"{model} - {name}", "interval") for name in rivals}
    upper = {name: interval[1] for name, interval in bounds.items() if interval}
    if not upper:
        return NONE
    least = max(upper, key=lambda name: upper[name])
    former = errors.verdict(bounds[least], seeds=2, drives=errors.LEAST_DRIVES)  # of figures without a verdict
    answer = get(results, f"{model} - {least}", "verdict") or former
    answer = "open" if answer == "better" and len(upper) < len(rivals) else answer
    words = BLIND if "blind" in least else "another scene" if "another" in least else CLAIMS.get(least, least)
    return f"{answer}, {difference(results, f'{model} - {least}')} to {words}"


def table2(results: Results) -> list[list[str]]:
    """Return rows of the paper's networks and claims, beside the paper's MSE."""
    rows = [["network", "paper: train MSE", "test", "here: test, rad²", "nmse", "95 % interval", "sa-gnn-ncp − it"]]
    for name in (*PAPER, *CLAIMS):
        key, paper = f"table2/angle-0/{name}", PAPER.get(name)
        published = [number(paper and paper.train_mse, ".3f"), number(paper and paper.test_mse, ".3f")]
        here = [text(results, key, "mse", ".5f"), text(results, key), text(results, key, "interval")]
        rows.append([name, *published, *here, difference(results, f"table2/angle-0/sa-gnn-ncp - {name}")])
    return rows


def coverage(results: Results) -> list[list[str]]:
    """Return how often intervals contain the true difference."""
    keys = [key.split("/")[1:] for key in results if key.startswith("coverage/")]
    sets, worlds = (dict.fromkeys(names) for names in zip(*keys, strict=True))
    tested = sorted(sets, key=lambda name: int(name.split()[0]))
    rows = [[name, *(text(results, f"coverage/{name}/{world}", form=".1%") for world in worlds)] for name in tested]
    return [["test set", *worlds], *rows]


def origins(results: Results) -> list[list[str]]:
    """Return the revisions and dates of each preset's figures."""
    made = sorted({(values["preset"], f"{values['revision']} of {values['date']}") for values in results.values()})
    presets = {preset: [origin for name, origin in made if name == preset] for preset, _ in made}
    return [["figures of", "revision"], *([preset, ", ".join(origins)] for preset, origins in presets.items())]


def plot(results: Results) -> Figure:
    """Return the validation nmse over the number of training roads, medians of seeds; stars: more steps."""
    figure = Figure(figsize=(7, 3), layout="constrained")
    axes = figure.subplots()
    for model, (label, form) in LINES.items():
        points = [values for key, values in results.items() if re.match(f"roads/val/{model}/", key)]
        equal = [values for values in points if values["roads"] * values["epochs"] == STEPS]
        equal.sort(key=lambda values: values["roads"])
        roads, seeds = [values["roads"] for values in equal], [values["seeds"] for values in equal]
        axes.plot(roads, np.median(seeds, axis=1), form, label=label)
        axes.plot(roads, seeds, f"{form[0]}.", markersize=4)
        for values in points:
            if values not in equal:
                axes.plot(values["roads"], values["figure"], f"{form[0]}*", markersize=11)
    axes.plot([], [], "k*", markersize=9, label="make roads: 12 epochs, three seeds")
    axes.set_xscale("log")
    axes.set_xticks([30, 60, 120, 240], ["30", "60", "120", "240"])
    axes.minorticks_off()
    axes.set(xlabel="training roads of 60 frames", ylabel="validation nmse", ylim=(0, None))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right center", frameon=False, fontsize="small")
    return figure


TABLES = {table.__name__: table for table in (overview, table2, coverage, origins)}

if __name__ == "__main__":
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    for command in (collect, render):
        app.command()(console.guarded(command))
    app()
