"""The table of a study, in Markdown and as rows of a CSV file."""

from typing import Any

from pipeline.report.studies.study import STUDIES, Points, Result, validation_nmse
from pipeline.report.tables.markdown import table

COLUMNS = ("test nmse", "95 % interval", "validation nmse", "MAE deg", "edges a frame", "parameters")


def markdown(name: str, points: Points) -> list[str]:
    """Return a study's lines."""
    head = [STUDIES[name].label, *COLUMNS]
    return [f"## {name}", "", *table(head, [_cells(value, result) for value, result in points]), ""]


def rows(name: str, points: Points) -> list[dict[str, Any]]:
    """Return a row for each point of a study, column → value."""
    return [_row(name, value, result) for value, result in points]


def _cells(value: float, result: Result) -> list[str]:
    test, edges, validation = result["test"], result["edges_per_frame"], validation_nmse(result)
    return [
        f"{value:g}",
        f"{test['nmse']:.3f}" + (f" ± {test['nmse_std']:.3f}" if test["nmse_std"] is not None else ""),
        "{:.3f} to {:.3f}".format(*test["nmse_ci95"]),
        "none" if validation is None else f"{validation:.3f}",
        f"{test['mae_deg']:.2f}",
        "none" if edges is None else f"{edges:,.0f}",
        f"{result['parameters']:,}",
    ]


def _row(study: str, value: float, result: Result) -> dict[str, Any]:
    test = result["test"]
    low, high = test["nmse_ci95"]
    return {
        "study": study, "value": f"{value:g}", "model": result["model"], "seeds": len(result["seeds"]),
        "test_nmse": test["nmse"], "test_nmse_std": test["nmse_std"], "test_nmse_low": low, "test_nmse_high": high,
        "val_nmse": validation_nmse(result), "test_mae_deg": test["mae_deg"],
        "edges_per_frame": result["edges_per_frame"], "parameters": result["parameters"],
    }  # fmt: skip
