"""Write results of stage evaluate with numbers that tests know."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base import store
from pipeline.report.results import Group, load_groups

DRIVES = ("2026_01_03_drive_0002", "2026_01_03_drive_0003")
ENTRY = {
    "input": "semantic", "spatial": "gnn", "temporal": "ncp", "cell": "ltc", "window": 8, "equivariant": False,
    "semantics": 1.0, "motion": "none", "horizon": 0, "fit_to": "train", "roads": None, "predict": "angle",
}  # fmt: skip
BASELINES = {"zero": 1.0, "train_mean": 1.0, "persistence": 0.01}
ANGLE = {"steering_rad": {"unit": "rad", "from_m": None, "to_m": None, "odometry_gain": None}}
PATH = {
    f"path_{start}-{stop}m_1pm": {"unit": "1/m", "from_m": float(start), "to_m": float(stop), "odometry_gain": None}
    for start, stop in ((0, 5), (5, 10))
}


def errors(nmse: float | None, frames: int = 40) -> dict[str, Any]:
    """Return errors on labels with a mean square of 0.01 rad²."""
    if nmse is None:
        return {"frames": 0, **dict.fromkeys(("mse", "rmse", "mae", "nmse"))}
    return {"frames": frames, "mse": 0.01 * nmse, "rmse": 0.1 * nmse**0.5, "mae": 0.08 * nmse**0.5, "nmse": nmse}


def scores(nmse: float | None, **baselines: float) -> dict[str, Any]:
    """Return the scores of a column in a split; the interval reaches from half of nmse to 1.5 times nmse."""
    bounds = None if nmse is None else [0.5 * nmse, 1.5 * nmse]
    known = {"baselines": {name: errors(value) for name, value in (BASELINES | baselines).items()}}
    bins = [
        {"from_1pm": 0.0, "to_1pm": 0.03, **errors(nmse), "zero": errors(1.0), "nmse_ci95": bounds},
        {"from_1pm": 0.03, "to_1pm": None, "frames": 0},
    ]
    return {
        **errors(nmse), "nmse_std": None, "nmse_ci95": bounds, "by_curvature": bins, "drift_m_per_100m": None, **known,
        "without_decisions": errors(nmse and nmse / 2) | known | {"nmse_ci95": bounds}, "uncertainty": None,
    }  # fmt: skip


def metrics(
    model: str, nmse: float | None = 0.2, odometry: dict[str, float] | None = None, **entry: Any
) -> dict[str, Any]:
    """Return the metrics.json of a model; `odometry`: nmse of odometry and regression."""
    columns = PATH if entry.get("predict") == "path" else ANGLE
    test = {column: scores(nmse, **odometry or {}) for column in columns}
    if not entry.get("horizon") and columns is ANGLE:
        test["steering_rad"]["drift_m_per_100m"] = 3.0
    return {
        "model": model, "entry": ENTRY | entry, "seeds": [0], "parameters": 9259, "wheelbase_m": 2.71,
        "labels": "oxts", "variant": {"k": 6, "keep_inter_class": 0.2},
        "points_per_frame": 1000.0, "edges_per_frame": 5160.0, "edges_per_frame_unpruned": 6000.0,
        "columns": columns, "val": None,
        "train": {column: scores(nmse and nmse / 2, **odometry or {}) for column in columns},
        "test": test,
    }  # fmt: skip


def predictions(error_rad: float, columns: dict[str, Any] = ANGLE) -> pd.DataFrame:
    """Return predictions.csv of two drives of 30 frames.

    Frame 20 is invalid, no window ends before frame 7, and odometry starts at frame 1.
    """
    frame = np.arange(30)
    driven = 0.01 * frame
    table = {"frame": frame, "time_s": 100 + frame / 10, "speed_mps": frame / 2, "onset": (frame == 15).astype(int)}
    for column in columns:
        table |= {
            f"true_{column}": np.where(frame == 20, np.nan, driven),
            f"predicted_{column}": np.where(frame < 7, np.nan, driven + error_rad),
            f"odometry_{column}": np.where(frame < 1, np.nan, driven + 0.001),
        }
    return pd.concat([pd.DataFrame({"drive": drive, **table}) for drive in DRIVES], ignore_index=True)


def write_model(data: Path, content: dict[str, Any], table: pd.DataFrame | None = None) -> None:
    """Write metrics.json, and predictions.csv for each seed, below data/evaluate."""
    folder = data / "evaluate" / content["model"]
    store.write_json(folder / "metrics.json", content, sort_keys=False)
    for number, seed in enumerate(content["seeds"]):
        own = folder / f"seed-{seed}" if number else folder
        own.mkdir(exist_ok=True)
        (predictions(0.01, content["columns"]) if table is None else table).to_csv(own / "predictions.csv", index=False)


def groups(data: Path, *contents: dict[str, Any]) -> list[Group]:
    """Write models and load their results."""
    for content in contents:
        write_model(data, content)
    return load_groups(data / "evaluate", [content["model"] for content in contents])
