"""Train one model on its graph variant: data/train/<model>/{best.pt, last.pt, config.json, curve.csv}.

On several GPUs: torchrun --nproc-per-node 2 -m stages.train MODEL; all processes must see the same files.
"""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from pipeline.base import console, store
from pipeline.base.errors import InputError, error_context
from pipeline.base.params import load, load_entry
from pipeline.base.resume import file_hash
from pipeline.base.runner import run_jobs
from pipeline.base.stage_folder import stage_folder
from pipeline.settings.models import Entry
from pipeline.settings.train import Train
from pipeline.train import distributed, runs


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models in the params file")],
    graphs: Path = Path("data/graphs"),
    labels: Path = Path("data/labels"),
    out: Annotated[Path, typer.Option(help="parent of the model's folder")] = Path("data/train"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Train the model, stop early when the validation error stops falling, and keep the best epoch.

    One network per seed, and per test drive with fit_to: others or both. Networks are trained in parallel, one process
    each; on a GPU as many as its free memory allows. Returns the model's folder.
    """
    from pipeline.train.training import Job, fit_run, networks_at_once

    entry, settings = load_entry(Entry, "models", name, params), load(Train, params)
    settings = settings.model_copy(update={"learning_rate": entry.learning_rate or settings.learning_rate})
    variant, where = graphs / entry.input, f"{params}: models.{name}"
    splits = store.read_index(variant, stage="graphs")
    with error_context(where=where):
        folds = runs.folds(splits, entry.fit_to, entry.roads)
    folds = runs.drop_untestable(folds, variant, labels, entry)
    drives = {drive for fold in folds for drive in fold.train + fold.val}
    files = {drive: [file_hash(folder / f"{drive}.h5") for folder in (variant, labels)] for drive in drives}
    with distributed.process_group() as (world, device), stage_folder(f"train@{name}", out / name) as stage:
        job = Job(name, where, entry, settings, variant, labels, splits, files, stage.kept)
        for fold in folds:
            job.target(job.read_drives(fold.train)), job.read_drives(fold.val)  # errors before anything is written
        todo = runs.runs(stage.new, settings.seeds, folds)
        if world.size > settings.batch_spans:
            raise InputError(
                f"train.batch_spans = {settings.batch_spans}, expected at least the {world.size} processes",
                params,
                "Raise it or start fewer processes",
            )
        if not folds[0].val and world.is_main:
            print(f"{name}: no validation drives, so no early stopping: keeps the last epoch", flush=True)
        at_once = networks_at_once(job, folds[0].train[0], device) if world.size == 1 else 1
        if len(todo) > 1 and at_once != 1:
            # Each process of a GPU reads with a thread: together they read in parallel, and need no shared memory.
            work = partial(fit_run, job=job, device=device, readers=None if at_once is None else 0)
            for _ in run_jobs(work, todo, workers=at_once, threads=1):
                pass
        else:
            for run in todo:
                fit_run(run, job, world, device)
        if world.is_main:
            # With folds, the first network has its own folder, and the model's config.json is a copy.
            config = store.read_json(todo[0].folder / "config.json", stage=f"train@{name}")
            store.write_json(stage.new / "config.json", config)
    return out / name


if __name__ == "__main__":
    console.run(main)
