"""The paper's Table 2 with what it lacks: what was trained, trivial predictors, intervals, sizes; in Markdown."""

from collections.abc import Sequence

from pipeline.base.params import SPLITS
from pipeline.report.tables import comparison
from pipeline.report.tables.comparison import KNOWABLE, Result
from pipeline.report.tables.markdown import table

Cells = dict[str, str]  # of a row: column → text

PAPER_UNIT = (
    "*Paper* is the train / test MSE of its Table 2, 0.077 to 0.268 rad² on test, beside models whose settings are its "
    "own. By its own label, always predicting zero has 0.0137 rad² on KITTI's longest drive, so that unit cannot be "
    "rad² of this label: compare with the paper by order and ratio."
)
READING = (
    "nmse = MSE / MSE of always predicting zero: 1 is useless, 0 perfect. The angle is that of *horizon* frames after "
    "the last one seen. *zero*, *train_mean* and *persistence* see no road; persistence is told the true angle of the "
    "frame before, or with a horizon that of the last one seen, which no model is. *odometry* is the angle measured "
    "from the last two images or scans, held. *Without decisions* leaves out the frames about the onset of a turn, "
    "until a second after it: who does not know the way cannot know them (pipeline/report/judge/decisions.py)."
)
COLUMNS = (
    "model", "input", "points", "semantics", "spatial", "temporal", "equivariant", "window", "motion", "horizon",
    "fitted to", "parameters", "edges (unpruned)", "MSE rad² train / val / test", "test nmse", "95 % interval",
    "MAE deg",
)  # fmt: skip
LAST = ("nmse without decisions", "paper")  # between them, the nmse of each test drive


def markdown(results: Sequence[Result], absent: Sequence[str] = ()) -> str:
    """Return the tables as Markdown; `absent` models are named with the command that gets them.

    `results` are :func:`comparison.in_order`: below the models of a horizon stand the trivial predictors at it.
    """
    drives = _short(comparison.drives_apart(results))
    columns, groups = [*COLUMNS, *drives.values(), *LAST], comparison.by_horizon(results)
    body: list[Cells] = []
    for group in groups:
        body += [_cells(result, drives) for result in group]
        horizon = str(comparison.horizon(group[0]))
        for name, of_split in comparison.baselines(group).items():
            body.append({"model": f"*{name}*", "horizon": horizon, **_scores(of_split, drives)})
    lines = table(columns, [[cells.get(column, "") for column in columns] for cells in body])
    if results:
        first = results[0]
        tested = ", ".join(first["drives"]["test"])
        lines += ["", f"Test: {first['test']['frames']} valid frames of {tested}. {READING} {_seeds(results)}"]
    for group in groups:
        lines += ["", *_by_curvature(group)]
    for model in absent:
        lines += ["", f"{model} is not evaluated on this machine: dvc repro --pull --downstream train@{model}"]
    return "\n".join([*lines, "", PAPER_UNIT, ""])


def _short(drives: Sequence[str]) -> Cells:
    """Return drive → its column, by its last number where that says which it is."""
    numbers = [drive.rpartition("_")[2] for drive in drives]
    alone = len(set(numbers)) == len(numbers)
    return {drive: f"nmse {number if alone else drive}" for drive, number in zip(drives, numbers, strict=True)}


def _cells(result: Result, drives: Cells) -> Cells:
    settings, test = result["line"], result["test"]
    cell, published, roads = comparison.cell(result), comparison.published(result), settings.get("roads")
    scores = _scores(result, drives)
    spread = "" if test["nmse_std"] is None else f" ± {test['nmse_std']:.3f}"
    return scores | {
        "model": result["model"],
        "input": settings["input"],
        "points": _count(result["points_per_frame"]),
        "semantics": f"{settings.get('semantics') or 0:g}",
        "spatial": settings["spatial"],
        "temporal": settings["temporal"] + (f" ({cell})" if cell else ""),
        "equivariant": "yes" if settings.get("equivariant") else "no",
        "window": str(settings["window"]),
        "motion": settings.get("motion", "none"),
        "horizon": str(comparison.horizon(result)),
        "fitted to": settings.get("fit_to", "train") + (f" ({roads} roads)" if roads else ""),
        "parameters": f"{result['parameters']:,}",
        "edges (unpruned)": _edges(result),
        "test nmse": scores["test nmse"] + spread,
        "95 % interval": "{:.3f} to {:.3f}".format(*test["nmse_ci95"]),
        "paper": f"{published.train_mse} / {published.test_mse}" if published else "",
    }


def _scores(of_split: Result, drives: Cells) -> Cells:
    """Return what models and trivial predictors have in common."""
    test = of_split["test"]
    return {
        "MSE rad² train / val / test": _errors(of_split),
        "test nmse": _figure(test["nmse"]),
        "MAE deg": "none" if test["mae_deg"] is None else f"{test['mae_deg']:.2f}",
        **{column: _figure(comparison.nmse_of_drive(test, drive)) for drive, column in drives.items()},
        "nmse without decisions": _figure(test.get(KNOWABLE, {}).get("nmse")),
    }


def _by_curvature(results: Sequence[Result]) -> list[str]:
    """Return a table of errors by how sharp the road bends: a model that only drives straight looks good on average."""
    bins, horizon = results[0]["test"]["by_curvature"], comparison.horizon(results[0])
    header = [
        f"test RMSE deg{f', {horizon} frames ahead,' if horizon else ''} where the road bends by … 1/m",
        *(f"{comparison.bounds(row)} ({row['frames']} frames)" for row in bins),
    ]
    body = [[result["model"], *(_degrees(row) for row in result["test"]["by_curvature"])] for result in results]
    return table(header, [*body, ["*zero*", *(_degrees(row.get("zero", {})) for row in bins)]])


def _errors(of_split: Result) -> str:
    errors = [(of_split[split] or {}).get("mse_rad2") for split in SPLITS]
    return " / ".join("none" if error is None else f"{error:.5f}" for error in errors)


def _figure(nmse: float | None) -> str:
    return "none" if nmse is None else f"{nmse:.3f}"


def _seeds(results: Sequence[Result]) -> str:
    counts = {len(result["seeds"]) for result in results}
    if counts == {1}:
        return "One seed each: how much a figure varies from training to training is not known."
    many = " to ".join(str(count) for count in sorted({min(counts), max(counts)}))
    return (
        f"Means over {many} seeds, ± one standard deviation from seed to seed; the interval is for other roads (block "
        "bootstrap over the test frames), given these networks."
    )


def _edges(result: Result) -> str:
    kept, every = result["edges_per_frame"], result["edges_per_frame_unpruned"]
    if kept is None:
        return "none"
    return f"{kept:,.0f}" if kept == every else f"{kept:,.0f} ({every:,.0f}, −{1 - kept / every:.0%})"


def _count(value: float | None) -> str:
    return "none" if value is None else f"{value:,.0f}"


def _degrees(scores: Result) -> str:
    return f"{scores['rmse_deg']:.2f}" if "rmse_deg" in scores else "none"
