"""Write results of stage evaluate with numbers that tests know."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base import store
from pipeline.evaluate.settings import Evaluate
from pipeline.report.values import Task, gather_values, load_tasks

SETTINGS = Evaluate(bootstrap_samples=50, bootstrap_block_s=0.5, seed=0)
DRIVES = ("2026_01_03_drive_0002", "2026_01_03_drive_0003")
ENTRY = {
    "input": "semantic",
    "spatial": "gnn",
    "temporal": "ncp",
    "cell": "ltc",
    "window": 8,
    "equivariant": False,
    "semantics": 1.0,
    "motion": "none",
    "horizon": 0,
    "predict": "angle",
    "scene": "same",
}
# Name of an input → its settings.
VARIANTS: dict[str, dict[str, Any]] = {
    "semantic": {"source": "clouds/pseudo", "k": 6, "keep_inter_class": 0.2},
    "depth": {"source": "clouds/pseudo", "k": 6},
    "lidar": {"source": "clouds/lidar", "k": 6},
    "lidar-50k": {"source": "clouds/lidar", "k": 6},
    "lidar-pointnet2": {"source": "clouds/lidar"},
}
LABELS = {"wheelbase_m": 2.5, "min_speed_mps": 1.0, "ahead_m": [0, 5, 10]}
ANGLE = ("steering_rad",)
PATH = ("path_0-5m_1pm", "path_5-10m_1pm")


def metrics(
    model: str,
    nmse: float | list[float] | None = 0.2,
    baselines: dict[str, float] | None = None,
    **entry: Any,
) -> dict[str, Any]:
    """Return the metrics.json of a model.

    `nmse`: for :func:`predictions`, as that of `baselines`.
    """
    columns = PATH if entry.get("predict") == "path" else ANGLE
    test = {"nmse": nmse, "baselines": baselines or {}}
    return {
        "model": model,
        "entry": ENTRY | entry,
        "seeds": [0],
        "parameters": 9259,
        "variant": VARIANTS[entry.get("input", ENTRY["input"])],
        "turning_frames": 1200,
        "points_per_frame": 1000.0,
        "edges_per_frame": 5160.0,
        "edges_per_frame_unpruned": 6000.0,
        "labels": LABELS,
        "val": None,
        "untrained": [],
        "test": dict.fromkeys(columns, test),
    }


def predictions(
    nmse: float | list[float] | None = 0.2,
    columns: Sequence[str] = ANGLE,
    baselines: dict[str, float] | None = None,
) -> pd.DataFrame:
    """Return predictions.csv of two drives of 30 frames, whose errors are multiples of the truth.

    `nmse`: on each drive, or on one each; None if both are straight. Frame 20 is invalid, no window
    ends before frame 7, odometry starts at frame 1.
    """
    frame = np.arange(30)
    driven = 0.01 * frame
    if nmse is None:
        driven = np.zeros(30)
    first_frames = {"predicted": 7, "odometry": 1}
    tables = []
    for drive, of_drive in zip(DRIVES, np.broadcast_to(nmse or 0.0, 2), strict=True):
        table = {"drive": drive, "frame": frame, "time_s": 100 + frame / 10, "speed_mps": frame / 2}
        errors = {"predicted": of_drive, "train_mean": 1.0} | (baselines or {})
        for column in columns:
            table[f"true_{column}"] = np.where(frame == 20, np.nan, driven)
            for name, error in errors.items():
                values = driven * (1 + np.sqrt(error))
                values[: first_frames.get(name, 0)] = np.nan
                table[f"{name}_{column}"] = values
        tables.append(pd.DataFrame(table))
    return pd.concat(tables, ignore_index=True)


def write_model(
    data: Path,
    content: dict[str, Any],
    table: pd.DataFrame | None = None,
    validation: pd.DataFrame | None = None,
) -> None:
    """Write metrics.json and predictions.csv below data/evaluate, and validation.csv if given.

    A table without seeds is that of each seed.
    """
    folder = data / "evaluate" / content["model"]
    store.write_json(folder / "metrics.json", content, sort_keys=False)
    if table is None:
        test = next(iter(content["test"].values()))
        table = predictions(test["nmse"], [*content["test"]], test["baselines"])
    for file, predicted in {"predictions.csv": table, "validation.csv": validation}.items():
        if predicted is None:
            continue
        seeds = [predicted]
        if "seed" not in predicted:
            seeds = [predicted.assign(seed=seed) for seed in content["seeds"]]
        pd.concat(seeds).assign(model=content["model"]).to_csv(folder / file, index=False)


def load(data: Path, *models: str) -> tuple[list[Task], pd.DataFrame]:
    """Return the tasks of models below data/evaluate, and their values."""
    tasks = load_tasks({model: data / "evaluate" / model for model in models})
    return tasks, gather_values(tasks, SETTINGS)


def compare(data: Path, *contents: dict[str, Any]) -> pd.DataFrame:
    """Write models and return their values."""
    for content in contents:
        write_model(data, content)
    _, values = load(data, *(content["model"] for content in contents))
    return values
