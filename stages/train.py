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
from pipeline.base.params import RATE_TOLERANCE, SPLITS, load, load_entry
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

    One network per seed: in parallel on CPUs, one process each, and one after the other on a GPU. Returns the model's
    folder.
    """
    settings = load(Train, params)
    entry = load_entry(Entry, "models", name, params)
    settings = settings.model_copy(update={"learning_rate": entry.learning_rate or settings.learning_rate})
    variant = data / "graphs" / entry.input
    splits = store.read_index(variant, stage="graphs")
    where = f"{params}: models.{name}"
    with error_context(where=where):
        runs.check(splits, entry.scene)
    parts = {split: store.drives_in(splits, split) for split in SPLITS}
    names = [drive for part in parts.values() for drive in part]
    drives = {drive: read_drive(variant, data / "labels", drive, entry) for drive in names}
    with stage_folder(f"train@{name}", out / name) as folder:
        # Errors before the first network is trained.
        for part in filter(None, parts.values()):
            check([drives[drive] for drive in part], entry.window)
        Scale.from_drives([drives[drive] for drive in parts["train"]])

        hz = {drive: 1 / np.median(np.diff(drives[drive].time_s)) for drive in names if len(drives[drive].time_s) > 1}
        usual_hz = np.median([hz[drive] for drive in parts["train"] if drive in hz])
        if others := [f"{drive} {hz[drive]:.1f}" for drive in hz if abs(hz[drive] / usual_hz - 1) > RATE_TOLERANCE]:
            print(f"{name}: training drives have {usual_hz:.1f} frames/s, but {', '.join(others)}", flush=True)
        if not parts["val"]:
            print(f"{name}: no validation drives, so no early stopping: keeps the last epoch", flush=True)

        todo = runs.runs(folder.new, settings.seeds)
        # A GPU trains one network at a time; a cluster has a worker per GPU, see CUDA_VISIBLE_DEVICES.
        alone = SCHEDULER not in os.environ and (torch.cuda.is_available() or default_workers() == 1)
        files = Files(drives[drive].graphs for drive in (*parts["train"], *parts["val"]))
        common: dict[str, Any] = {"name": name, "where": where, "entry": entry, "settings": settings}
        common |= {"splits": splits, "drives": drives, "files": files if alone else None, "kept": folder.kept}
        job = partial(fit_run, **common)
        if alone or len(todo) == 1:
            folder.used.update(map(job, todo))
        else:
            folder.used.update(state for _, state in run_jobs(job, todo, threads=1))
        folder.used.update(folder.kept.glob("*.pt"))  # of all code and settings: small, and costly to make
    return out / name


if __name__ == "__main__":
    console.run(main)
