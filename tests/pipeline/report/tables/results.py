"""Evaluated models' metrics.json with figures made up."""

from typing import Any

SETTINGS = {"input": "semantic", "spatial": "gnn", "temporal": "ncp", "cell": "ltc", "window": 8, "equivariant": False}


def scores(nmse: float, frames: int = 40) -> dict[str, Any]:
    """Return what is said of a split whose labels have a mean square of 0.01 rad²."""
    errors = {"frames": frames, "mse_rad2": 0.01 * nmse, "rmse_deg": 5.73 * nmse**0.5, "mae_deg": 4 * nmse**0.5}
    zero = {"frames": frames, "mse_rad2": 0.01, "rmse_deg": 5.73, "mae_deg": 4.0, "nmse": 1.0}
    return {
        **errors,
        "nmse": nmse,
        "nmse_std": None,
        "nmse_ci95": [0.5 * nmse, 1.5 * nmse],
        "baselines": dict.fromkeys(("zero", "train_mean", "persistence"), zero),
        "by_curvature": [
            {"from_1pm": 0.0, "to_1pm": 0.03, **errors, "nmse": nmse, "zero": zero},
            {"from_1pm": 0.03, "to_1pm": None, "frames": 0},
        ],
    }


def result(model: str, nmse: float = 0.2, **settings: Any) -> dict[str, Any]:
    """Return the metrics.json of a model with these settings."""
    return {
        "model": model,
        "line": {**SETTINGS, **settings},
        "seeds": [0],
        "drives": {"train": ["one"], "val": [], "test": ["two", "three"]},
        "parameters": 9259,
        "points_per_frame": 1000.0,
        "edges_per_frame": 5160.0,
        "edges_per_frame_unpruned": 6000.0,
        "train": scores(nmse / 2),
        "val": None,
        "test": scores(nmse),
    }
