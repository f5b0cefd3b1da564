"""Fit the networks of a model, one per seed."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from models.steering.core.steering_net import SteeringNet
from pipeline.base import checkpoint, store
from pipeline.base.errors import error_context
from pipeline.base.executors import SCHEDULER, run_jobs
from pipeline.base.keys import stage_key
from pipeline.base.outputs import StageFolder
from pipeline.train import runs, trained
from pipeline.train.entry import Entry
from pipeline.train.fit import Fit, selected_epoch
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


def fit_model(model: Model, todo: Sequence[runs.Run], folder: StageFolder) -> list[Path]:
    """Train the networks of a model; return the files of their states.

    On CPUs and on a cluster the networks are trained in parallel, each in a process. On a GPU of
    this machine they are trained one after the other.
    """
    names = store.drives_in(model.splits, "train", "val")
    files = Files(model.drives[name].graphs for name in names)
    job = partial(fit_run, model, files=files, code=folder.code.hash(), kept=folder.kept)

    workers = None
    if torch.cuda.is_available() and SCHEDULER not in os.environ:
        workers = 1
    return [state for _, state in run_jobs(job, todo, folder, workers=workers, threads=1)]


def fit_run(model: Model, run: runs.Run, files: Files, code: str, kept: Path) -> Path:
    """Train a network of a model, and write best.pt and curve.csv. Raises InputError.

    The training continues from the state of an earlier run if there is one. `code` is the hash of
    the stage's code, `kept` the folder in which states are kept between runs. Returns the file of
    the state.
    """
    entry = model.entry.seeded(run.seed)
    train = model.usable_drives("train")
    val = model.usable_drives("val")
    with error_context(where=model.where):
        net = _build_network(entry, train[0], run.seed)

    # The state of an earlier run can be continued if it had the same code, inputs and files.
    inputs = {
        "entry": entry.model_dump(mode="json"),
        "train": model.settings.model_dump(exclude={"seeds"}),
        "seed": run.seed,
        "drives": [drive.name for drive in train],
        "val": [drive.name for drive in val],
    }
    paths = [path for drive in train + val for path in (drive.graphs, drive.labels)]
    state = kept / f"{stage_key(code, inputs, paths)}.pt"

    fit = Fit(net, entry, model.settings, run.seed, train, val, files)
    fit.train_network(state, f"{model.name} seed {run.seed}")

    intervals_s = np.concatenate([np.diff(drive.time_s) for drive in train])
    best = {
        "kind": trained.KIND,
        "name": model.name,
        "seeds": model.settings.seeds,
        "contents": train[0].contents._asdict(),
        "settings": train[0].settings,
        "datasets": sorted({drive.settings.get("dataset", "unknown") for drive in train}),
        "fps": float(1 / np.median(intervals_s)),
        **inputs,
        "scale": fit.scale.content,
        "code": trained.code_hashes(entry),
        "epoch": selected_epoch(fit.curve),
        "net": fit.best,
    }
    checkpoint.write(run.folder / "best.pt", best)
    curve = pd.DataFrame(fit.curve)
    curve.to_csv(run.folder / "curve.csv", index=False, float_format="%.6g", lineterminator="\n")
    return state


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
