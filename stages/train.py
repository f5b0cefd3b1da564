"""Stage train: train a model on its graph variant, and write best.pt and curve.csv.

They are in data/train/<model>/.
"""

import os
from functools import partial
from pathlib import Path

import torch

from pipeline.jobs import console
from pipeline.jobs.console import EntryName
from pipeline.jobs.executors import SCHEDULER, run_jobs
from pipeline.jobs.keys import stage_key
from pipeline.jobs.outputs import StageFolder, stage_folder
from pipeline.jobs.progress import Progress

from pipeline.base import store
from pipeline.base.errors import error_context
from pipeline.base.hashes import file_hash
from pipeline.base.params import SPLITS, entry_name, load_entry, load_section
from pipeline.train import runs
from pipeline.train.entry import Entry
from pipeline.train.fit_model import Model, Task, fit_run
from pipeline.train.frames import Files
from pipeline.train.loss import Scale
from pipeline.train.settings import Train
from pipeline.train.targets import check_drives, read_drive


def main(
    name: EntryName = None, data: Path = Path("data"), params: Path = Path("params.yaml")
) -> Path:
    """Train the model, stop early when the validation error stops falling, and keep the best epoch.

    One network is trained per seed. On CPUs, networks are trained in parallel, each in a process.
    On a GPU, they are trained one after the other. Returns the model's folder.
    """
    name = entry_name(name)
    out = data / "train" / name
    entry = load_entry(Entry, "models", name, params)
    settings = entry.override(load_section(Train, params))
    graphs = data / "graphs" / entry.input
    with stage_folder(f"train@{name}", out, params=params, chosen=entry.files) as folder:
        splits = store.read_index(graphs, stage="graphs")
        where = f"{params}: models.{name}"
        with error_context(where=where):
            runs.check_splits(splits)

        drives = {}
        for split in SPLITS:
            for drive in store.drives_in(splits, split):
                drives[drive] = read_drive(graphs, data / "labels", data / "motion", drive, entry)

        # Raise InputError for drives from which nothing can be learned before the first network is
        # trained. Scale is made only for its checks.
        for split in SPLITS:
            members = [drives[drive] for drive in store.drives_in(splits, split)]
            if members:
                check_drives(members, entry.window)
        train_drives = store.drives_in(splits, "train")
        Scale.from_drives([drives[drive] for drive in train_drives])
        if not store.drives_in(splits, "val"):
            print(
                f"{name}: no validation drives, so no early stopping: keeps the last epoch",
                flush=True,
            )

        # On CPUs and on a cluster, networks are trained in parallel. On a GPU of this machine, they
        # are trained one after the other, and share the frames in its memory.
        workers = None
        if torch.cuda.is_available() and SCHEDULER not in os.environ:
            workers = 1
        model = Model(name, where, entry, settings, splits, drives)
        names = store.drives_in(splits, "train", "val")
        work = partial(fit_run, model, Files(drives[name].graphs for name in names))
        tasks = list_tasks(model, folder, workers)
        for _ in run_jobs(work, tasks, folder, workers=workers, threads=1):
            pass
        # The states of networks of other code and settings stay for later runs, too, as they are
        # small and costly to train.
        folder.used.update(folder.kept.glob("*.pt"))
    return out


def list_tasks(model: Model, folder: StageFolder, workers: int | None) -> list[Task]:
    """Return the networks to train, one per seed.

    The state of an earlier run is continued if it had the same code, inputs and files. `workers` is
    an argument of :func:`run_jobs`.
    """
    code = folder.code.hash()
    files = [file_hash(path) for path in model.input_files()]
    tasks = list[Task]()
    for run in runs.list_runs(folder.new, model.settings.seeds):
        key = stage_key(code, model.inputs(run.seed), files)
        # Of networks that are trained in parallel, only the first has a bar on a terminal.
        title = f"{model.name} seed {run.seed}"
        has_bar = workers == 1 or not tasks
        progress = Progress(title, model.settings.epochs, has_bar)
        tasks.append(Task(run, folder.kept / f"{key}.pt", title, progress.watch_steps))
    return tasks


if __name__ == "__main__":
    console.run(main)
