"""Fit the networks of a model, one per seed."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch

from models.steering.core.steering_net import SteeringNet
from pipeline.base import checkpoint, store
from pipeline.base.errors import error_context
from pipeline.train import runs, trained
from pipeline.train.entry import Entry
from pipeline.train.fit import Fit, Watch, selected_epoch
from pipeline.train.frames import Files
from pipeline.train.settings import Train
from pipeline.train.targets import Drives, LabelledDrive


@dataclass(frozen=True)
class Model:
    """Settings and drives that all networks of a model share."""

    name: str
    where: str  # the place of its entry, for messages
    entry: Entry
    settings: Train
    splits: Mapping[str, str]  # drive → split
    drives: Drives

    def usable_drives(self, split: str) -> list[LabelledDrive]:
        """Return the drives of a split that have a window."""
        drives = [self.drives[name] for name in store.drives_in(self.splits, split)]
        return [drive for drive in drives if drive.has_window(self.entry.window)]

    def inputs(self, seed: int) -> dict[str, Any]:
        """Return what determines the network of a seed, besides code and files."""
        return {
            "entry": self.entry.seeded(seed).model_dump(mode="json"),
            "train": self.settings.model_dump(exclude={"seeds"}),
            "seed": seed,
            "drives": [drive.name for drive in self.usable_drives("train")],
            "val": [drive.name for drive in self.usable_drives("val")],
        }

    def input_files(self) -> list[Path]:
        """Return the files that the networks are trained with: graphs, labels and motion.

        Motion is one of them only if it is an input, so that other networks are kept after an edit
        of stage motion.
        """
        paths = []
        for drive in self.usable_drives("train") + self.usable_drives("val"):
            paths += [drive.graphs, drive.labels]
            if self.entry.motion != "none":
                paths.append(drive.motion_file)
        return paths


class Task(NamedTuple):
    """A network to train."""

    run: runs.Run
    # File with the state of the training, from which an interrupted one continues.
    state: Path
    # Name for the log.
    title: str
    # Says how far an epoch is.
    watch: Watch


def fit_run(model: Model, files: Files, task: Task) -> None:
    """Train a network of a model, and write best.pt and curve.csv. Raises InputError.

    `files` are the graph files of the model's drives.
    """
    run = task.run
    entry = model.entry.seeded(run.seed)
    train = model.usable_drives("train")
    val = model.usable_drives("val")
    with error_context(where=model.where):
        net = _build_network(entry, train[0], run.seed)

    fit = Fit(net, entry, model.settings, run.seed, train, val, files, task.watch)
    fit.train_network(task.state, task.title)

    intervals_s = np.concatenate([np.diff(drive.time_s) for drive in train])
    best = {
        "kind": trained.KIND,
        "name": model.name,
        "seeds": model.settings.seeds,
        "contents": train[0].contents._asdict(),
        "settings": train[0].settings,
        "datasets": sorted({drive.settings.get("dataset", "unknown") for drive in train}),
        "fps": float(1 / np.median(intervals_s)),
        **model.inputs(run.seed),
        "scale": fit.scale.content,
        "code": trained.code_hashes(entry),
        "epoch": selected_epoch(fit.curve),
        "net": fit.best,
    }
    checkpoint.write(run.folder / "best.pt", best)
    curve = pd.DataFrame(fit.curve)
    curve.to_csv(run.folder / "curve.csv", index=False, float_format="%.6g", lineterminator="\n")


def _build_network(entry: Entry, drive: LabelledDrive, seed: int) -> SteeringNet:
    """Build a network for the frames and columns of a drive. Raises InputError.

    The settings of torch make sure that two runs with the same seed have the same results.
    """
    device = "cuda" if torch.cuda.is_available() else "cpu"
    if device == "cpu":
        torch.set_num_threads(1)  # rounding of sums depends on the number of threads
    torch.backends.cudnn.allow_tf32 = False  # convolutions compute in float32
    torch.manual_seed(seed)
    net = entry.build(**drive.contents._asdict(), outputs=len(drive.quantity.columns))
    entry.start(net)
    return net.to(device)
