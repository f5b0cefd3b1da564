"""The steering table as rows of a CSV file."""

from collections.abc import Sequence
from typing import Any

from pipeline.base.params import SPLITS
from pipeline.report.tables import comparison
from pipeline.report.tables.comparison import KNOWABLE, Result

SETTINGS = (
    "input", "spatial", "temporal", "cell", "equivariant", "semantics", "window", "motion", "horizon", "fit_to",
    "roads",
)  # fmt: skip


def rows(results: Sequence[Result]) -> list[dict[str, Any]]:
    """Return a row for each model, column → value, and below those of a horizon its trivial predictors.

    `results` are :func:`comparison.in_order`. A trivial predictor's row lacks most columns.
    """
    drives = comparison.drives_apart(results)
    body: list[dict[str, Any]] = []
    for group in comparison.by_horizon(results):
        body += [_row(result, drives) for result in group]
        horizon = comparison.horizon(group[0])
        for name, of_split in comparison.baselines(group).items():
            body.append({"model": name, "horizon": horizon, **_scores(of_split, drives)})
    return body


def _row(result: Result, drives: Sequence[str]) -> dict[str, Any]:
    settings, test, published = result["line"], result["test"], comparison.published(result)
    low, high = test["nmse_ci95"]
    return {
        "model": result["model"],
        **{key: settings.get(key) for key in SETTINGS},
        "cell": comparison.cell(result),
        **{key: result[key] for key in ("points_per_frame", "parameters")},
        **{key: result[key] for key in ("edges_per_frame", "edges_per_frame_unpruned")},
        "seeds": len(result["seeds"]),
        **_scores(result, drives),
        "test_nmse_std": test["nmse_std"],
        "test_nmse_low": low,
        "test_nmse_high": high,
        **{f"test_rmse_deg {comparison.bounds(row)} 1/m": row.get("rmse_deg") for row in test["by_curvature"]},
        "paper_train_mse": published and published.train_mse,
        "paper_test_mse": published and published.test_mse,
    }


def _scores(of_split: Result, drives: Sequence[str]) -> dict[str, Any]:
    """Return what models and trivial predictors have in common."""
    test, knowable = of_split["test"], of_split["test"].get(KNOWABLE, {})
    return {
        **{f"{split}_mse_rad2": of_split[split] and of_split[split]["mse_rad2"] for split in SPLITS},
        **{f"test_{key}": test[key] for key in ("frames", "nmse", "mae_deg")},
        **{f"test_nmse {drive}": comparison.nmse_of_drive(test, drive) for drive in drives},
        **{f"test_{KNOWABLE}_{key}": knowable.get(key) for key in ("frames", "nmse")},
    }
