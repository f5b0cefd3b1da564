"""Train one model on its graph variant: data/train/<model>/{best.pt, curve.csv}."""

import os
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer

from pipeline.base import console, store
from pipeline.base.errors import error_context
from pipeline.base.executors import SCHEDULER, default_workers, run_jobs
from pipeline.base.outputs import stage_folder
from pipeline.base.params import RATE_TOLERANCE, load, load_entry
from pipeline.settings.models import Entry
from pipeline.settings.train import Train
from pipeline.train import runs
from pipeline.train.fit import fit_run
from pipeline.train.frames import Files
from pipeline.train.loss import Scale
from pipeline.train.targets import check, read_drive


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models in the params file")],
    data: Path = Path("data"),
    out: Annotated[Path, typer.Option(help="parent of the model's folder")] = Path("data/train"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Train the model, stop early when the validation error stops falling, and keep the best epoch.

    One network per seed and fold, see pipeline/train/runs.py: in parallel on CPUs, one process each, and one after the
    other on a GPU. Returns the model's folder.
    """
    entry, settings = load_entry(Entry, "models", name, params), load(Train, params)
    settings = settings.model_copy(update={"learning_rate": entry.learning_rate or settings.learning_rate})
    variant, where = data / "graphs" / entry.input, f"{params}: models.{name}"
    splits = store.read_index(variant, stage="graphs")
    with error_context(where=where):
        folds = runs.folds(splits, entry)
    every = [*filter(None, [folds[0].start]), *folds]
    parts = [part for fold in every for part in (fold.train, fold.val)] + [tuple(store.drives_in(splits, "test"))]
    names = dict.fromkeys(drive for part in parts for drive in part)
    drives = {drive: read_drive(variant, data / "labels", drive, entry) for drive in names}
    with stage_folder(f"train@{name}", out / name) as folder:
        for part in filter(None, parts):  # errors before the first network is trained
            check([drives[drive] for drive in part], entry.window)
        hz = {drive: 1 / np.median(np.diff(drives[drive].time_s)) for drive in names if len(drives[drive].time_s) > 1}
        usual_hz = np.median([hz[drive] for drive in every[0].train if drive in hz])
        if others := [f"{drive} {hz[drive]:.1f}" for drive in hz if abs(hz[drive] / usual_hz - 1) > RATE_TOLERANCE]:
            print(f"{name}: training drives have {usual_hz:.1f} frames/s, but {', '.join(others)}", flush=True)
        for fold in every:
            Scale.from_drives([drives[drive] for drive in fold.train])
        if not every[0].val:
            print(f"{name}: no validation drives, so no early stopping: keeps the last epoch", flush=True)
        todo = runs.runs(folder.new, settings.seeds, folds)
        # A GPU trains one network at a time; a cluster has a worker per GPU, see CUDA_VISIBLE_DEVICES.
        alone = SCHEDULER not in os.environ and (torch.cuda.is_available() or default_workers() == 1)
        files = Files(drives[drive].graphs for fold in every for drive in (*fold.train, *fold.val))
        common: dict[str, Any] = {"name": name, "where": where, "entry": entry, "settings": settings, "drives": drives}
        job = partial(fit_run, **common, files=files if alone else None, kept=folder.kept)
        for group in ([*dict.fromkeys(run.start for run in todo if run.start)], todo):
            here = len(group) == 1 or alone
            folder.used.update(map(job, group) if here else (state for _, state in run_jobs(job, group, threads=1)))
        folder.used.update(folder.kept.glob("*.pt"))  # of all code and settings: small, and costly to make
    return out / name


if __name__ == "__main__":
    console.run(main)
