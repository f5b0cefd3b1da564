"""Train one run, from its drives to its folder: best.pt, curve.csv."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from models.steering.core import steering_net
from pipeline.base.errors import error_context
from pipeline.base.resume import file_hash, revision, stage_key
from pipeline.graphs import graph_file
from pipeline.settings.models import Entry
from pipeline.settings.train import Train
from pipeline.train import checkpoint, fit, predict
from pipeline.train.labelled_drive import LabelledDrive, read_drives
from pipeline.train.runs import Run
from pipeline.train.scale import Scale

SMALL = 8_000  # points per frame


@dataclass(frozen=True)
class Job:
    """Inputs common to all runs of a model."""

    name: str
    where: str  # of its entry, for messages
    entry: Entry
    settings: Train
    variant: Path  # folder of graphs
    labels: Path
    splits: dict[str, str]  # drive → split
    kept: Path  # folder for the states of interrupted runs

    def read_drives(self, names: tuple[str, ...]) -> list[LabelledDrive]:
        """Read drives with targets for this model."""
        return read_drives(self.variant, self.labels, names, self.entry.window, **self.entry.reading)


def fit_run(run: Run, job: Job) -> None:
    """Train one network, from an interrupted run's state if there is one, and write its folder.

    Raises InputError: the network does not fit the graphs, or the loss is not finite.
    """
    entry, settings, fold = job.entry, job.settings, run.fold
    train, val = job.read_drives(fold.train), job.read_drives(fold.val)
    with graph_file.open_graphs(train[0].graphs) as graphs:
        contents, points = graphs.contents, graphs.points_per_frame
    device = "cuda" if torch.cuda.is_available() else "cpu"
    if device == "cpu" and 0 < points < SMALL:
        # With few points a second thread has little to do, and slows each of a step's hundreds of small operations
        # where another process uses its core. One thread's sums are also the same on each machine.
        torch.set_num_threads(1)
    torch.manual_seed(run.seed)
    scale = Scale.from_drives(train)
    with error_context(where=job.where):
        net = entry.build(**contents.model_dump(), outputs=len(scale.names))
    net.to(device, torch.float64 if settings.precision == "float64" else None)
    inputs = {
        "entry": entry.model_dump(mode="json"),
        "train": settings.model_dump(exclude={"seeds"}),
        "seed": run.seed,
        "splits": job.splits,
        "fold": fold.name,
    }
    files = [file_hash(path) for drive in train + val for path in (drive.graphs, drive.labels)]
    state = job.kept / f"{stage_key('train', inputs, files)}.pt"
    steps_s = np.concatenate([np.diff(drive.time_s) for drive in train])
    metadata: dict[str, Any] = {
        "kind": predict.KIND,
        "name": job.name,
        "seeds": settings.seeds,
        "contents": contents.model_dump(exclude_defaults=True),
        "scale": scale.content,
        "settings": train[0].settings,
        "drives": [drive.name for drive in train],
        "fps": float(1 / np.median(steps_s)),
        "parameters": steering_net.parameter_count(net),
        "revision": revision(),
        **inputs,
    }
    fitted = fit.Fit(net, entry, settings, run.seed, scale)
    fitted.run(train, val, state, metadata, f"{job.name} {run}")
    best = {"scale": fitted.scale.content, "epoch": fit.selected_epoch(fitted.curve), "net": fitted.best}
    checkpoint.write(run.folder / "best.pt", metadata | best)
    fit.write_curve(run.folder / "curve.csv", fitted.curve)
