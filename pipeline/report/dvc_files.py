"""Write the files of DVC's own views: metrics.json for `dvc metrics`, learning/ and steering/ for `dvc plots`.

The first seed of a model has file ``<model>.csv``, further seeds ``<model>.seed-<n>.csv``; networks of folds have
``<model>.fold-<drive>.csv`` and ``<model>.seed-<n>.fold-<drive>.csv``.
"""

from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.base.atomic import replacing
from pipeline.base.errors import error_context
from pipeline.report import perception
from pipeline.report.results import Results

_LEARNING = ["epoch", "train_loss", "val_nmse"]


def metrics(results: Results, scores: dict[str, Any] | None) -> dict[str, float]:
    """Return all metrics under flat names; values that do not exist are left out, and DVC shows a gap.

    - ``<model>.nmse``, its 95 % interval ``nmse_low`` to ``nmse_high``, ``mae_deg``
    - ``odometry-<horizon>.nmse`` on the test drives; ``odometry_lidar-…`` from scans, if there are images too
    - ``encoder.miou`` of classes; ``encoder.abs_rel_dense`` and ``encoder.abs_rel_lidar`` of depth
    - ``motion.<kind>.nmse`` of the steering angle from measured motion, ``yaw_rmse_degps``, ``speed_ratio``, ``valid``

    Names of the other splits start with ``train_`` or ``val_``. `scores` is the result of `perception.load_scores`.
    """
    values: dict[str, Any] = {}
    columns = {
        "nmse": "test.nmse", "nmse_low": "test.nmse_low", "nmse_high": "test.nmse_high", "mae_deg": "test.mae_deg",
        "train_nmse": "train.nmse", "val_nmse": "val.nmse",
    }  # fmt: skip
    for _, row in results.metrics.iterrows():
        if not row["baseline"]:
            values |= {f"{row['model']}.{name}": row.get(column) for name, column in columns.items()}
        elif row["model"].startswith("odometry"):
            values[f"{row['model']}-{row['line.horizon']}.nmse"] = row["test.nmse"]
    values |= perception.metrics(scores) if scores else {}
    return {name: value for name, value in values.items() if pd.notna(value)}


def load_curves(model: Path) -> dict[str, pd.DataFrame]:
    """Load the learning curves in a model's folder of stage train: name of the network → epoch, train_loss, val_nmse.

    Numbers stay text, as written. Raises InputError if a curve.csv is damaged.
    """
    curves = {}
    for path in sorted(model.rglob("curve.csv")):
        with error_context(path, fix=f"Recreate it: dvc repro --force --single-item train@{model.name}"):
            table = pd.read_csv(path, usecols=_LEARNING, dtype=str)
            table.astype(float)  # raises ValueError
        curves[".".join([model.name, *path.relative_to(model).parts[:-1]])] = table[_LEARNING]
    return curves


def write_learning(model: Path, out: Path) -> None:
    """Write the learning curve of each network in a model's folder of stage train to folder `out`."""
    for name, curve in load_curves(model).items():
        write_csv(out / f"{name}.csv", curve)


def write_steering(predictions: pd.DataFrame, out: Path) -> None:
    """Write true and predicted steering on the test drives to folder `out`, one file per model and seed.

    Column ``row`` counts on from drive to drive.
    """
    for (model, run), table in predictions.groupby(["model", "run"]):
        angles = {name: table[name].map("{:.4f}".format) for name in ("driven_deg", "predicted_deg")}
        time_s = table["time_s"].map("{:.6f}".format)
        written = table[["drive", "frame"]].assign(time_s=time_s, **angles)
        written.insert(0, "row", range(len(table)))
        write_csv(out / f"{'.'.join(filter(None, [model, run]))}.csv", written)


def write_csv(path: Path, table: pd.DataFrame, na: str = "nan") -> None:
    """Write a table without its index in one step. DVC draws an empty field as 0, and nan as a gap."""
    with replacing(path) as unfinished:
        table.to_csv(unfinished, index=False, lineterminator="\n", na_rep=na)
