"""Evaluated models' metrics.json with figures made up."""

from typing import Any

SETTINGS = {"input": "semantic", "spatial": "gnn", "temporal": "ncp", "cell": "ltc", "window": 8, "equivariant": False}
BASELINES = {"zero": 1.0, "train_mean": 1.0, "persistence": 0.01}


def errors(nmse: float, frames: int = 40) -> dict[str, Any]:
    """Return errors on labels that have a mean square of 0.01 rad²."""
    return {
        "frames": frames,
        "mse_rad2": 0.01 * nmse,
        "rmse_deg": 5.73 * nmse**0.5,
        "mae_deg": 4 * nmse**0.5,
        "nmse": nmse,
    }


def part(nmse: float, baselines: dict[str, float], frames: int = 40) -> dict[str, Any]:
    """Return what is said of some frames of a split."""
    return {**errors(nmse, frames), "baselines": {name: errors(of, frames) for name, of in baselines.items()}}


def scores(nmse: float, drives: tuple[str, ...] = (), **odometry: float) -> dict[str, Any]:
    """Return what is said of a split whose `drives` are 0.01, 0.02, … better than all, and which knows `odometry`."""
    baselines = {**BASELINES, **odometry}
    return {
        **part(nmse, baselines),
        "nmse_std": None,
        "nmse_ci95": [0.5 * nmse, 1.5 * nmse],
        "by_curvature": [
            {"from_1pm": 0.0, "to_1pm": 0.03, **errors(nmse), "zero": errors(1.0)},
            {"from_1pm": 0.03, "to_1pm": None, "frames": 0},
        ],
        "by_drive": {drive: part(nmse - row / 100, baselines, 20) for row, drive in enumerate(drives, start=1)},
        "drift_m_per_100m": 3.0,
        "without_decisions": part(nmse / 2, {name: of / 2 for name, of in baselines.items()}, 30),
    }


def result(model: str, nmse: float = 0.2, odometry: dict[str, float] | None = None, **settings: Any) -> dict[str, Any]:
    """Return the metrics.json of a model with these settings."""
    drives = ("2026_01_03_drive_0002", "2026_01_03_drive_0003")
    return {
        "model": model,
        "line": {**SETTINGS, **settings},
        "seeds": [0],
        "drives": {"train": ["one"], "val": [], "test": list(drives)},
        "parameters": 9259,
        "wheelbase_m": 2.71,
        "path": "bicycle",
        "variant": {"k": 6, "keep_inter_class": 0.2, "accumulate": None},
        "points_per_frame": 1000.0,
        "edges_per_frame": 5160.0,
        "edges_per_frame_unpruned": 6000.0,
        "train": scores(nmse / 2, **odometry or {}),
        "val": None,
        "test": scores(nmse, drives, **odometry or {}),
    }
