"""The paper's Table 2 with what it lacks: what was trained, trivial predictors, intervals, sizes. Markdown and CSV."""

from collections.abc import Sequence
from typing import Any

from pipeline.base.params import SPLITS
from pipeline.report.tables import paper
from pipeline.report.tables.markdown import table

Result = dict[str, Any]  # a model's metrics.json

PAPER_UNIT = (
    "*Paper* is the train / test MSE of its Table 2, 0.077 to 0.268 rad² on test, beside models whose settings are its "
    "own. By its own label, always predicting zero has 0.0137 rad² on KITTI's longest drive, so that unit cannot be "
    "rad² of this label: compare with the paper by order and ratio."
)
READING = (
    "nmse = MSE / MSE of always predicting zero: 1 is useless, 0 perfect. *zero*, *train_mean* and *persistence* "
    "see no road; persistence is told the true angle of the frame before, which no model is."
)
BASELINES = ("zero", "train_mean", "persistence")
SETTINGS = ("input", "spatial", "temporal", "cell", "equivariant", "semantics", "window")
COLUMNS = (
    "model", "input", "points", "semantics", "spatial", "temporal", "equivariant", "window", "parameters",
    "edges (unpruned)", "MSE rad² train / val / test", "test nmse", "95 % interval", "MAE deg", "paper",
)  # fmt: skip


def in_order(results: Sequence[Result]) -> list[Result]:
    """Return the paper's networks in its order, then ours as they come."""
    order = [*paper.PAPER, None]
    return sorted(results, key=lambda result: order.index(paper.name(result["line"])))


def markdown(results: Sequence[Result], absent: Sequence[str] = ()) -> str:
    """Return the tables as Markdown; `absent` models are named with the command that gets them."""
    baselines = [_baseline_cells(name, of_split) for name, of_split in _baselines(results).items()]
    lines = table(COLUMNS, [*map(_cells, results), *baselines])
    if results:
        first = results[0]
        drives = ", ".join(first["drives"]["test"])
        lines += ["", f"Test: {first['test']['frames']} valid frames of {drives}. {READING} {_seeds(results)}"]
        lines += ["", *_by_curvature(results)]
    for model in absent:
        lines += ["", f"{model} is not evaluated on this machine: dvc repro --pull --downstream train@{model}"]
    return "\n".join([*lines, "", PAPER_UNIT, ""])


def rows(results: Sequence[Result]) -> list[dict[str, Any]]:
    """Return the same as rows for a CSV file, column → value; a trivial predictor's row lacks most columns."""
    return [
        *map(_row, results),
        *(_baseline_row(name, of_split) for name, of_split in _baselines(results).items()),
    ]


def _row(result: Result) -> dict[str, Any]:
    settings, test = result["line"], result["test"]
    low, high = test["nmse_ci95"]
    published = _published(result)
    return {
        "model": result["model"],
        **{key: settings.get(key) for key in SETTINGS},
        "cell": _cell(settings),
        **{key: result[key] for key in ("points_per_frame", "parameters")},
        **{key: result[key] for key in ("edges_per_frame", "edges_per_frame_unpruned")},
        "seeds": len(result["seeds"]),
        **{f"{split}_mse_rad2": _mse(result[split]) for split in SPLITS},
        **{f"test_{key}": test[key] for key in ("frames", "nmse", "nmse_std", "mae_deg")},
        "test_nmse_low": low,
        "test_nmse_high": high,
        **{f"test_rmse_deg {_bounds(row)} 1/m": row.get("rmse_deg") for row in test["by_curvature"]},
        "paper_train_mse": published and published.train_mse,
        "paper_test_mse": published and published.test_mse,
    }


def _baseline_row(name: str, of_split: Result) -> dict[str, Any]:
    test = of_split["test"]
    mse = {f"{split}_mse_rad2": _mse(scores) for split, scores in of_split.items()}
    return {"model": name, **mse, **{f"test_{key}": test[key] for key in ("frames", "nmse", "mae_deg")}}


def _cells(result: Result) -> list[str]:
    settings, test, published = result["line"], result["test"], _published(result)
    cell = _cell(settings)
    return [
        result["model"], settings["input"], _count(result["points_per_frame"]), f"{settings.get('semantics') or 0:g}",
        settings["spatial"], settings["temporal"] + (f" ({cell})" if cell else ""),
        "yes" if settings.get("equivariant") else "no", str(settings["window"]), f"{result['parameters']:,}",
        _edges(result), _errors(result), _nmse(test), "{:.3f} to {:.3f}".format(*test["nmse_ci95"]),
        f"{test['mae_deg']:.2f}", f"{published.train_mse} / {published.test_mse}" if published else "",
    ]  # fmt: skip


def _baseline_cells(name: str, of_split: Result) -> list[str]:
    test = of_split["test"]
    scores = {
        "model": f"*{name}*",
        "MSE rad² train / val / test": _errors(of_split),
        "test nmse": f"{test['nmse']:.3f}",
        "MAE deg": f"{test['mae_deg']:.2f}",
    }
    return [scores.get(column, "") for column in COLUMNS]


def _cell(settings: Result) -> str | None:
    """Return the neuron of a network that has a choice of them."""
    return settings.get("cell") if settings["temporal"] == "ncp" else None


def _published(result: Result) -> paper.Published | None:
    name = paper.name(result["line"])
    return paper.PAPER[name] if name else None


def _baselines(results: Sequence[Result]) -> dict[str, Result]:
    """Return for each trivial predictor its scores on each split, over the first model's frames."""
    if not results:
        return {}
    first = results[0]
    return {name: {split: first[split] and first[split]["baselines"][name] for split in SPLITS} for name in BASELINES}


def _by_curvature(results: Sequence[Result]) -> list[str]:
    """Return a table of errors by how sharp the road bends: a model that only drives straight looks good on average."""
    bins = results[0]["test"]["by_curvature"]
    header = [
        "test RMSE deg where the road bends by … 1/m",
        *(f"{_bounds(row)} ({row['frames']} frames)" for row in bins),
    ]
    body = [[result["model"], *(_degrees(row) for row in result["test"]["by_curvature"])] for result in results]
    return table(header, [*body, ["*zero*", *(_degrees(row.get("zero", {})) for row in bins)]])


def _mse(scores: Result | None) -> float | None:
    return scores["mse_rad2"] if scores else None


def _errors(of_split: Result) -> str:
    return " / ".join(f"{of_split[split]['mse_rad2']:.5f}" if of_split[split] else "none" for split in SPLITS)


def _nmse(test: Result) -> str:
    return f"{test['nmse']:.3f}" + ("" if test["nmse_std"] is None else f" ± {test['nmse_std']:.3f}")


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


def _bounds(row: Result) -> str:
    return f"≥ {row['from_1pm']:g}" if row["to_1pm"] is None else f"{row['from_1pm']:g} to {row['to_1pm']:g}"
