"""Collect figures of runs in docs/results.json, and render the tables of the pages and docs/roads.png from it.

    python -m docs.make_results collect runs/roads roads    # a finished run and its preset, or a JSON file of figures
    python -m docs.make_results render

A key is PRESET/GROUP/ROW: roads/angle-10/motion-10 or, of a range, roads/path-0/10-20 m/path. A row is a model, a
baseline, or "A - B", their paired difference in nmse. PRESET/val/… are validation errors.
"""

import json
import re
from dataclasses import replace
from datetime import date
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.base.params import load
from pipeline.base.resume import revision
from pipeline.report import street_view
from pipeline.report.paper import CLAIMS, PAPER
from pipeline.report.results import BASELINES, NO_LEARNING, Group, load_groups
from pipeline.report.tables import NONE, Table, claim_cells, number
from pipeline.settings.evaluate import Evaluate

DOCS = Path(__file__).parent
PAGES = (DOCS.parent / "README.md", DOCS / "results.md")
TABLE = re.compile(r"(<!-- table: (\w+) -->).*?(<!-- end -->)", re.DOTALL)
BLIND = "motion only"
OMITTED = "2011_09_26_drive_0005"  # of the six real drives: an earlier result rested on it
MOTION = ("motion-10", "motion-10-blind", "motion-10-another")
PATH = ("path", "path-blind", "path-another")
OTHERS = ("path-others", "path-blind-others", "path-another-others")
THEN = ("path-then", "path-blind-others", "path-another-then")
Results = dict[str, dict[str, Any]]
# Each: question, group of results, and in it the model with the scene; without it, and with another scene.
Questions = tuple[tuple[str, str, tuple[str, ...]], ...]
BEYOND: Questions = (
    ("present angle by the scene alone, 48 rendered roads", "table2/angle-0", ("sa-gnn-ncp",)),
    ("… 240 rendered roads", "roads/angle-0", ("sa-gnn-ncp",)),
    ("angle a second ahead, 240 rendered roads", "roads/angle-10", MOTION),
    ("path 5 to 10 m ahead, 240 rendered roads", "roads/path-0/5-10 m", PATH),
    ("path 10 to 20 m ahead, 240 rendered roads", "roads/path-0/10-20 m", PATH),
    ("angle a second ahead, six drives of KITTI, trained on 240 rendered roads", "transfer/angle-10", MOTION),
    ("path 5 to 10 m ahead, six drives of KITTI, trained on 240 rendered roads", "transfer/path-0/5-10 m", PATH),
    ("… trained on the other five drives; not fixed beforehand", "real/path-0/5-10 m", OTHERS),
)
REAL: Questions = (  # the same of the six real drives, in docs/results.md
    ("240 rendered roads: angle a second ahead, without 0005", "transfer/angle-10 without 0005", MOTION),
    ("… path 5 to 10 m ahead, without 0005", "transfer/path-0 without 0005/5-10 m", PATH),
    ("the other five real drives: path 5 to 10 m ahead, without 0005", "real/path-0 without 0005/5-10 m", OTHERS),
    ("… path 10 to 20 m ahead", "real/path-0/10-20 m", OTHERS),
    ("… and before on 48 rendered roads: path 5 to 10 m ahead", "real/path-0/5-10 m", THEN),
    ("… path 10 to 20 m ahead", "real/path-0/10-20 m", THEN),
)


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
    """Return figures with all of the groups that `new` has replaced."""
    groups = {tuple(key.split("/")[:2]) for key in new}
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
    params, figures = run / "params.yaml", Results()
    folders = {path.parent.name: path.parent for path in sorted((run / "data/evaluate").glob("*/metrics.json"))}
    for whole in load_groups(folders, load(Evaluate, params)):
        for group in (whole, *without(whole, OMITTED)):
            figures |= figures_of_group(group)
        for row in (row for row in whole.models if row["val_nmse"] < np.inf):
            seeds = np.mean([scores["nmse_by_seed"] for scores in row["val"].values()], axis=0).tolist()
            figures[f"val/{row['model']}"] = entry(row["val_nmse"], seeds=seeds, roads=len(row["drives"]["train"]))
    if (path := run / "data/scores/metrics.json").is_file():
        for kind, splits in store.read_json(path, stage="scores")["motion"].items():
            if splits["test"]:
                figures[f"motion/{kind}"] = entry(splits["test"]["nmse"], frames=splits["test"]["judged"])
    return figures


def without(group: Group, drive: str) -> list[Group]:
    """Return the group without a drive, and the drive's number in its key; an empty list if it has no such drive."""
    names = sorted({*group.predictions["drive"]})
    if drive not in names:
        return []
    truth = np.where((group.drive == names.index(drive))[:, None], np.nan, group.truth)
    return [replace(group, key=f"{group.key} without {drive[-4:]}", truth=truth)]


def figures_of_group(group: Group) -> Results:
    """Return the errors of models and baselines, and the differences of models in question to all others."""
    figures: Results = {}
    rows = [name for name in group.predicted if name not in BASELINES or name in NO_LEARNING]
    models = {claim.model for claim in CLAIMS} | {name for _, _, (name, *_) in (*BEYOND, *REAL)}
    for column, label in group.labels.items():
        part = f"{group.key}/{label}".rstrip("/")
        for name in rows:
            scores = group.scores(name, column)
            seeds, mse, frames = scores["by_seed"], scores["mse"], scores["frames"]
            mae_deg = scores["mae"] and np.degrees(scores["mae"] * group.length_m[column])
            value, bounds = group.nmse(name, column=column)
            figures[f"{part}/{name}"] = entry(value, bounds, frames, seeds=seeds, mse=mse, mae_deg=mae_deg)
        for first, other in product(models.intersection(rows), rows):
            if first != other:
                value, bounds, verdict = group.difference(first, other, column)
                figures[f"{part}/{first} - {other}"] = entry(value, bounds, frames, verdict=verdict)
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


def claims(results: Results) -> list[list[str]]:
    """Return a row per claim of the paper."""
    rows = []
    for claim in CLAIMS:
        pair = [f"table2/angle-0/{name}" for name in (claim.model, claim.rival)]
        errors = [(get(results, key), get(results, key, "mae_deg")) for key in pair]
        key = f"{pair[0]} - {claim.rival}"
        difference = get(results, key), get(results, key, "interval"), get(results, key, "verdict")
        if None not in difference:
            rows.append(claim_cells(claim, errors, difference))
    table = Table("", rows)
    return [table.heads, *([re.sub(r"-(?=\d\.)", "−", cell) for cell in row] for row in table.cells)]


def beyond(results: Results) -> list[list[str]]:
    """Return a row per question beyond the paper, and rows of measured motion."""
    teams = min(text(results, f"udacity/{team}") for team in ("autumn", "komanda", "rambo"))
    wheel = f"{text(results, 'udacity/steer measure')} rad"
    measured = "steering wheel by measured motion, Udacity's test drive, RMSE"
    udacity = [measured, wheel, *[NONE] * 3, f"best of three teams: {teams} rad"]
    motion = sorted({text(results, key) for key in results if key.startswith("real/motion/")})
    measured = "present angle by measured motion, six drives of KITTI"
    kitti = [measured, " to ".join(dict.fromkeys((motion[0], motion[-1]))), *[NONE] * 4]
    return [*questions(results, "nmse on unseen drives", BEYOND), udacity, kitti]


def real(results: Results) -> list[list[str]]:
    """Return a row per further question on the six real drives."""
    return questions(results, "nmse on six drives of KITTI, trained on", REAL)


def questions(results: Results, head: str, asked: Questions) -> list[list[str]]:
    """Return a row per question whose figures are known."""
    rows = [[head, "without learning", BLIND, "with the scene", "mean error, °", "does the scene help?"]]
    for question, group, (model, *controls) in asked:
        if (key := f"{group}/{model}") in results:
            errors = {name: get(results, f"{group}/{name}") for name in NO_LEARNING}
            best = min((name for name in errors if errors[name] is not None), key=lambda name: errors[name])
            blind = next((name for name in controls if "blind" in name), "")
            nmse = [text(results, f"{group}/{name}") for name in (best, blind, model)]
            degrees = text(results, key, "mae_deg", ".2f")
            rows.append([question, *nmse, degrees, shown(results, key, [best, *controls])])
    return rows


def shown(results: Results, model: str, rivals: list[str]) -> str:
    """Return the difference to the rival whose interval has the greatest upper bound, and what it shows."""
    bounds = {name: get(results, f"{model} - {name}", "interval") for name in rivals}
    upper = {name: interval[1] for name, interval in bounds.items() if interval}
    if not upper:
        return NONE
    least = max(upper, key=lambda name: upper[name])
    answer = get(results, f"{model} - {least}", "verdict")
    answer = "open" if answer == "better" and len(upper) < len(rivals) else answer
    words = "no learning" if least in NO_LEARNING else BLIND if "blind" in least else "another scene"
    return f"{answer}, {difference(results, f'{model} - {least}')} to {words}"


def table2(results: Results) -> list[list[str]]:
    """Return a row per network, first the paper's, beside the paper's MSE."""
    heads = ["network", "paper: train MSE", "test", "here: test, rad²", "nmse", "95 % interval", "sa-gnn-ncp − it"]
    names = re.findall(r"^table2/angle-0/(\S+)$", "\n".join(results), re.MULTILINE)
    rows = []
    for name in (*PAPER, *(name for name in names if name not in (*PAPER, *NO_LEARNING))):
        key, paper = f"table2/angle-0/{name}", PAPER.get(name)
        published = [number(paper and paper.train_mse, ".3f"), number(paper and paper.test_mse, ".3f")]
        here = [text(results, key, "mse", ".5f"), text(results, key), text(results, key, "interval")]
        rows.append([name, *published, *here, difference(results, f"table2/angle-0/sa-gnn-ncp - {name}")])
    return [heads, *rows]


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
    """Return sa-gnn-ncp's validation nmse over the number of training roads: a dot per seed, a line of the medians."""
    points = [values for key, values in results.items() if re.fullmatch(r"roads/val/sa-gnn-ncp(-\d+)?", key)]
    points.sort(key=lambda values: values["roads"])
    figure = Figure(figsize=(7, 3), layout="constrained")
    axes = figure.subplots()
    axes.plot([values["roads"] for values in points], [np.median(values["seeds"]) for values in points], "b-")
    for values in points:
        axes.plot([values["roads"]] * len(values["seeds"]), values["seeds"], "b.", markersize=4)
    axes.set_xscale("log")
    axes.set_xticks([30, 60, 120, 240], ["30", "60", "120", "240"])
    axes.minorticks_off()
    axes.set(xlabel="training roads of 60 frames, equally many steps", ylabel="validation nmse", ylim=(0, None))
    axes.grid(alpha=0.3)
    return figure


TABLES = {table.__name__: table for table in (claims, beyond, real, table2, coverage, origins)}

if __name__ == "__main__":
    console.run(collect, render)
