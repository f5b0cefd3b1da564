"""Train one model on its graph variant: data/train/<model>/{best.pt, last.pt, config.json, curve.csv}.

On several GPUs: torchrun --nproc-per-node 2 -m stages.train MODEL; all processes must see the same files.
"""

import shutil
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from pipeline.base import console, store
from pipeline.base.errors import InputError, error_context
from pipeline.base.lock import exclusive
from pipeline.base.params import load, load_entry
from pipeline.base.resume import file_hash
from pipeline.base.runner import run_jobs
from pipeline.sections.models import Model
from pipeline.sections.train import Train
from pipeline.train import distributed, runs, windows
from pipeline.train.judged import judged


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models: in the params file")],
    graphs: Path = Path("data/graphs"),
    labels: Path = Path("data/labels"),
    out: Annotated[Path, typer.Option(help="the model gets a folder in it")] = Path("data/train"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Fit the model to the training drives, stop when the validation error no longer falls, keep the best epoch.

    A network for each seed, and for each test drive with fit_to: others or both. On a CPU, several are fitted side by
    side, with a thread each. Returns the model's folder.
    """
    from models.steering.core import steering_net
    from pipeline.train.training import Job, fit_run, ms_per_frame

    model, settings = load_entry(Model, "models", name, params), load(Train, params)
    settings = settings.model_copy(update={"learning_rate": model.learning_rate or settings.learning_rate})
    variant, where = graphs / model.input, f"{params}: models.{name}"
    splits = store.read_index(variant, stage="graphs")
    with error_context(where=where):
        line = steering_net.resolved(model.model_dump())
        folds = runs.folds(splits, line)
    folds = judged(folds, variant, labels, line)
    for fold in folds:
        for learned in (fold.train, fold.val):
            windows.read_drives(variant, labels, learned, model.window, model.horizon, model.motion)
    todo = runs.runs(out / name, settings.seeds, folds)
    kept = out.parent / ".resume" / f"{out.name}-{name}"
    drives = {drive for fold in folds for drive in fold.train + fold.val}
    files = {drive: [file_hash(folder / f"{drive}.h5") for folder in (variant, labels)] for drive in drives}
    job = Job(name, where, line, settings, variant, labels, splits, files, kept)
    with distributed.joined() as (world, device), exclusive(out / name, kept) if world.leads else nullcontext():
        if world.size > settings.batch_runs:
            raise InputError(
                f"{params}: train.batch_runs = {settings.batch_runs}: the runs of a step cannot be spread over "
                f"{world.size} processes: raise it, or start fewer"
            )
        if not folds[0].val and world.leads:
            print(f"{name}: no validation drives, so no early stopping: the last epoch counts as the best", flush=True)
        if len(todo) > 1 and world.size == 1 and device.type == "cpu":
            for _ in run_jobs(partial(fit_run, job=job), todo, threads=1):
                pass
        else:
            for run in todo:
                fit_run(run, job, world, device)
        if world.leads:  # a model's config.json is that of its first network
            config = store.read_json(todo[0].folder / "config.json", stage=f"train@{name}")
            config["encode_ms_per_frame"] = ms_per_frame(todo[0], job, device)
            store.write_json(out / name / "config.json", config)
            shutil.rmtree(kept)
    return out / name


if __name__ == "__main__":
    console.run(main)
