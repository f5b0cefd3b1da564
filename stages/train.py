"""Train one model on its graph variant: data/train/<model>/{best.pt, curve.csv}."""

import os
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from pipeline.base import console, store
from pipeline.base.errors import error_context
from pipeline.base.executors import SCHEDULER, default_workers, run_jobs
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load, load_entry
from pipeline.settings.models import Entry
from pipeline.settings.train import Train
from pipeline.train import runs
from pipeline.train.scale import Scale


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models in the params file")],
    graphs: Path = Path("data/graphs"),
    labels: Path = Path("data/labels"),
    out: Annotated[Path, typer.Option(help="parent of the model's folder")] = Path("data/train"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Train the model, stop early when the validation error stops falling, and keep the best epoch.

    One network per seed, and per test drive with fit_to: others or both. Networks are trained in parallel on CPUs, one
    process each, and one after the other on a GPU. Returns the model's folder.
    """
    import torch

    from pipeline.train.training import Job, fit_run

    entry, settings = load_entry(Entry, "models", name, params), load(Train, params)
    settings = settings.model_copy(update={"learning_rate": entry.learning_rate or settings.learning_rate})
    variant, where = graphs / entry.input, f"{params}: models.{name}"
    splits = store.read_index(variant, stage="graphs")
    with error_context(where=where):
        folds = runs.folds(splits, entry.fit_to, entry.roads)
    folds = runs.drop_untestable(folds, variant, labels, entry)
    with stage_folder(f"train@{name}", out / name) as folder:
        job = Job(name, where, entry, settings, variant, labels, splits, folder.kept)
        for fold in folds:  # errors before the first network is trained
            Scale.from_drives(job.read_drives(fold.train)), job.read_drives(fold.val)
        todo = runs.runs(folder.new, settings.seeds, folds)
        if not folds[0].val:
            print(f"{name}: no validation drives, so no early stopping: keeps the last epoch", flush=True)
        # A GPU trains one network at a time; a cluster has a worker per GPU, see CUDA_VISIBLE_DEVICES.
        alone = SCHEDULER not in os.environ and (torch.cuda.is_available() or default_workers() == 1)
        if len(todo) == 1 or alone:
            for run in todo:
                fit_run(run, job)
        else:
            for _ in run_jobs(partial(fit_run, job=job), todo, threads=1):
                pass
    return out / name


if __name__ == "__main__":
    console.run(main)
