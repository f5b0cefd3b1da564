"""The paper's Table 2 with what it lacks: trivial predictors, intervals, sizes. As Markdown and as rows for CSV."""

from collections.abc import Sequence
from typing import Any

from pipeline.base.params import SPLITS

Result = dict[str, Any]  # a model's metrics.json

# Train and test MSE of the paper's Table 2.
PAPER = {
    "cnn-ncp": (0.108, 0.2676),
    "gnn-lstm": (0.033, 0.130),
    "gnn-ncp": (0.046, 0.132),
    "pointnet2-lstm": (0.032, 0.182),
    "pointnet2-ncp": (0.053, 0.240),
    "do-gnn-ncp": (0.038, 0.081),
    "sa-gnn-ncp": (0.037, 0.0771),
}
PAPER_UNIT = (
    "*Paper* is the train / test MSE of its Table 2, 0.077 to 0.268 rad² on test. By its own label, always predicting "
    "zero has 0.0137 rad² on KITTI's longest drive, so that unit cannot be rad² of this label: compare with the paper "
    "by order and ratio."
)
READING = (
    "nmse = MSE / MSE of always predicting zero: 1 is useless, 0 perfect. *zero*, *train_mean* and *persistence* "
    "see no road; persistence is told the true angle of the frame before, which no model is."
)
BASELINES = ("zero", "train_mean", "persistence")
COLUMNS = (
    "model", "input", "frames", "points", "parameters", "edges (unpruned)", "MSE rad² train / val / test", "test nmse",
    "95 % interval", "MAE deg", "ms per frame", "paper",
)  # fmt: skip


def markdown(results: Sequence[Result], absent: Sequence[str] = ()) -> str:
    """Return the tables as Markdown; `absent` models are named with the command that gets them."""
    lines = table(
        COLUMNS,
        [
            *map(_cells, results),
            *(_baseline_cells(name, of_split) for name, of_split in _baselines(results).items()),
        ],
    )
    if results:
        first = results[0]
        drives = ", ".join(first["drives"]["test"])
        lines += ["", f"Test: {first['test']['frames']} valid frames of {drives}. {READING} {_seeds(results)}"]
        lines += ["", *_by_curvature(results)]
    for model in absent:
        lines += ["", f"{model} is not evaluated on this machine: dvc pull evaluate@{model}, or dvc repro."]
    return "\n".join([*lines, "", PAPER_UNIT, ""])


def rows(results: Sequence[Result]) -> list[dict[str, Any]]:
    """Return the same as rows for a CSV file, column → value; a trivial predictor's row lacks most columns."""
    found = []
    for result in results:
        line, test = result["line"], result["test"]
        low, high = test["nmse_ci95"]
        paper_train, paper_test = PAPER.get(result["model"], (None, None))
        found.append(
            {
                "model": result["model"],
                **{key: line[key] for key in ("input", "spatial", "temporal")},
                "frames_per_window": line["window"],
                **{key: result[key] for key in ("points_per_frame", "parameters", "encode_ms_per_frame")},
                **{key: result[key] for key in ("edges_per_frame", "edges_per_frame_unpruned")},
                "seeds": len(result["seeds"]),
                **{f"{split}_mse_rad2": _mse(result[split]) for split in SPLITS},
                **{f"test_{key}": test[key] for key in ("frames", "nmse", "nmse_std", "mae_deg")},
                "test_nmse_low": low,
                "test_nmse_high": high,
                **{f"test_rmse_deg {_bounds(row)} 1/m": row.get("rmse_deg") for row in test["by_curvature"]},
                "paper_train_mse": paper_train,
                "paper_test_mse": paper_test,
            }
        )
    for name, of_split in _baselines(results).items():
        test = of_split["test"]
        mse = {f"{split}_mse_rad2": _mse(scores) for split, scores in of_split.items()}
        found.append({"model": name, **mse, **{f"test_{key}": test[key] for key in ("frames", "nmse", "mae_deg")}})
    return found


def _cells(result: Result) -> list[str]:
    line, test = result["line"], result["test"]
    paper = PAPER.get(result["model"])
    return [
        result["model"], line["input"], str(line["window"]), _count(result["points_per_frame"]),
        f"{result['parameters']:,}", _edges(result), _errors(result), _nmse(test),
        "{:.3f} to {:.3f}".format(*test["nmse_ci95"]), f"{test['mae_deg']:.2f}",
        f"{result['encode_ms_per_frame']:.2f}", f"{paper[0]} / {paper[1]}" if paper else "",
    ]  # fmt: skip


def _baseline_cells(name: str, of_split: Result) -> list[str]:
    test = of_split["test"]
    scores = [_errors(of_split), f"{test['nmse']:.3f}", "", f"{test['mae_deg']:.2f}"]
    return [f"*{name}*", "", "", "", "", "", *scores, "", ""]


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


def table(header: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    """Return a Markdown table's lines."""
    return ["| " + " | ".join(cells) + " |" for cells in (header, ["---"] * len(header), *body)]


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
