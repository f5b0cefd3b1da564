"""Gather the learning curves of all networks in one table, which ``dvc plots`` draws."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from pipeline.report.values import Task
from pipeline.train import runs

# Columns of the table: a row per network and epoch. A network without validation has no val_nmse.
COLUMNS = ["model", "seed", "epoch", "learning_rate", "train_loss", "val_nmse"]


def gather_curves(tasks: Sequence[Task], train: Path) -> pd.DataFrame:
    """Return the learning curves of the models of some tasks.

    `train` is the folder of stage train. Networks that are not on this machine have no rows.
    """
    tables = [pd.DataFrame(columns=COLUMNS)]
    for task in tasks:
        for model, content in task.models.items():
            for run in runs.list_runs(train / model, content["seeds"]):
                path = run.folder / "curve.csv"
                if path.is_file():
                    # Numbers stay texts, so that they are written as they were read.
                    curve = pd.read_csv(path, dtype=str)
                    tables.append(curve.assign(model=model, seed=run.seed))
    return pd.concat(tables)[COLUMNS]
