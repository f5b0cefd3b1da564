"""Write results of stage evaluate with numbers that tests know."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base import store
from pipeline.report.results import Results, load_results

DRIVES = ("2026_01_03_drive_0002", "2026_01_03_drive_0003")
LINE = {
    "input": "semantic", "spatial": "gnn", "temporal": "ncp", "cell": "ltc", "window": 8, "equivariant": False,
    "semantics": 1.0, "motion": "none", "horizon": 0, "fit_to": "train", "roads": None,
}  # fmt: skip
BASELINES = {"zero": 1.0, "train_mean": 1.0, "persistence": 0.01}


def errors(nmse: float | None, frames: int = 40) -> dict[str, Any]:
    """Return errors on labels with a mean square of 0.01 rad²."""
    if nmse is None:
        return {"frames": 0, **dict.fromkeys(("mse_rad2", "rmse_deg", "mae_deg", "nmse"))}
    numbers = {"mse_rad2": 0.01 * nmse, "rmse_deg": 5.73 * nmse**0.5, "mae_deg": 4 * nmse**0.5, "nmse": nmse}
    return {"frames": frames, **numbers}


def part(nmse: float, odometry: dict[str, float | None], frames: int = 40) -> dict[str, Any]:
    baselines = {name: errors(value, frames) for name, value in {**BASELINES, **odometry}.items()}
    return {**errors(nmse, frames), "baselines": baselines}


def around(nmse: float) -> list[float]:
    return [0.5 * nmse, 1.5 * nmse]


def scores(nmse: float, drives: tuple[str, ...] = (), **odometry: float | None) -> dict[str, Any]:
    """Return the scores of a split; drives are 0.01, 0.02, … better than all together."""
    return {
        **part(nmse, odometry),
        "nmse_std": None,
        "nmse_ci95": around(nmse),
        "by_curvature": [
            {"from_1pm": 0.0, "to_1pm": 0.03, **errors(nmse), "zero": errors(1.0), "nmse_ci95": around(nmse)},
            {
                "from_1pm": 0.03,
                "to_1pm": 0.1,
                **errors(4 * nmse),
                "zero": errors(9.0),
                "nmse_ci95": around(nmse * 4 / 9),
            },
            {"from_1pm": 0.1, "to_1pm": None, "frames": 0},
        ],
        "by_drive": {drive: part(nmse - row / 100, odometry, 20) for row, drive in enumerate(drives, start=1)},
        "drift_m_per_100m": 3.0,
        "without_decisions": part(nmse / 2, odometry, 30),
    }


def metrics(
    model: str, nmse: float = 0.2, odometry: dict[str, float | None] | None = None, **settings: Any
) -> dict[str, Any]:
    """Return the metrics.json of a model."""
    return {
        "model": model,
        "line": {**LINE, **settings},
        "seeds": [0],
        "drives": {"train": ["one"], "val": [], "test": [*DRIVES]},
        "parameters": 9259,
        "wheelbase_m": 2.71,
        "path": "bicycle",
        "variant": {"k": 6, "keep_inter_class": 0.2, "accumulate": None},
        "points_per_frame": 1000.0,
        "edges_per_frame": 5160.0,
        "edges_per_frame_unpruned": 6000.0,
        "train": scores(nmse / 2, **odometry or {}),
        "val": None,
        "test": scores(nmse, DRIVES, **odometry or {}),
    }


def predictions(error_rad: float, odometry: bool = True) -> pd.DataFrame:
    """Return predictions.csv of two drives, 30 frames each: frame 20 is invalid, no window ends before frame 7."""
    frame = np.arange(30)
    driven = 0.01 * frame
    table = {
        "frame": frame,
        "time_s": 100 + frame / 10,
        "speed_mps": frame / 2,
        "steering_rad": driven,
        "predicted_rad": np.where(frame < 7, np.nan, driven + error_rad),
        "valid": (frame != 20).astype(int),
        "onset": (frame == 15).astype(int),
        "odometry_rad": driven + 0.001 if odometry else np.nan,
    }
    return pd.concat([pd.DataFrame({"drive": drive, **table}) for drive in DRIVES])


def write_model(data: Path, content: dict[str, Any], table: pd.DataFrame | None = None) -> None:
    """Write metrics.json, and predictions.csv for each seed, below data/evaluate."""
    folder = data / "evaluate" / content["model"]
    store.write_json(folder / "metrics.json", content)
    for number, seed in enumerate(content["seeds"]):
        own = folder / f"seed-{seed}" if number else folder
        own.mkdir(exist_ok=True)
        (predictions(0.01) if table is None else table).to_csv(own / "predictions.csv", index=False)


def results(data: Path, *contents: dict[str, Any]) -> Results:
    """Write models and load their results."""
    for content in contents:
        write_model(data, content)
    return load_results(data / "evaluate", [content["model"] for content in contents])
