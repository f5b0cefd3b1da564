"""Write the files of DVC's own views: metrics.json for `dvc metrics`, learning/ for `dvc plots`.

The first seed of a model has file ``<model>.csv``, further seeds ``<model>.seed-<n>.csv``; networks of folds have
``<model>.fold-<drive>.csv`` and ``<model>.seed-<n>.fold-<drive>.csv``.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.report.results import Group

_LEARNING = ["epoch", "train_loss", "val_nmse"]


def metrics(groups: Sequence[Group]) -> dict[str, float]:
    """Return all metrics under flat names; values that do not exist are left out, and DVC shows a gap.

    - ``<model>.nmse`` and its 95 % interval ``nmse_low`` to ``nmse_high``; of a range of the path ahead
      ``<model>.nmse_5-10m`` and so on
    - ``odometry-angle-<horizon>`` and ``odometry-path-<horizon>``: the same of odometry

    Names of the other splits start with ``train_`` or ``val_``.
    """
    values: dict[str, Any] = {}
    for group in groups:
        named = {row["model"]: row for row in group.models}
        named |= {f"odometry-{group.key}": row for row in group.rows if row["model"] == "odometry"}
        for name, row in named.items():
            for column, label in group.labels.items():
                nmse, test = f"nmse_{label}".strip("_").replace(" ", ""), row["test"][column]
                low, high = test.get("nmse_ci95") or (None, None)
                values |= {f"{name}.{nmse}": test["nmse"], f"{name}.{nmse}_low": low, f"{name}.{nmse}_high": high}
                for split in ("train", "val"):
                    values[f"{name}.{split}_{nmse}"] = row[split] and row[split][column]["nmse"]
    return {name: value for name, value in values.items() if value is not None}


def load_curves(model: Path) -> dict[str, pd.DataFrame]:
    """Load the learning curves in a model's folder of stage train: name of the network → epoch, train_loss, val_nmse.

    Numbers stay text, as written.
    """
    curves = {}
    for path in sorted(model.rglob("curve.csv")):
        table = pd.read_csv(path, usecols=_LEARNING, dtype=str)
        curves[".".join([model.name, *path.relative_to(model).parts[:-1]])] = table[_LEARNING]
    return curves


def write_learning(model: Path, out: Path) -> None:
    """Write the learning curve of each network in a model's folder of stage train to folder `out`.

    DVC draws an empty field as 0, and nan as a gap.
    """
    for name, curve in load_curves(model).items():
        curve.to_csv(out / f"{name}.csv", index=False, lineterminator="\n", na_rep="nan")
