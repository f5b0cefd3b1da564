"""Fit the networks of a model, one per seed."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from pipeline.base import checkpoint, store
from pipeline.base.errors import error_context
from pipeline.base.executors import SCHEDULER, default_workers, run_jobs
from pipeline.base.outputs import StageFolder
from pipeline.base.resume import stage_key
from pipeline.train import runs, trained
from pipeline.train.entry import Entry
from pipeline.train.fit import Fit, selected_epoch
from pipeline.train.frames import Files
from pipeline.train.settings import Train
from pipeline.train.targets import Drives


def fit_model(
    todo: Sequence[runs.Run],
    name: str,
    where: str,
    entry: Entry,
    settings: Train,
    splits: Mapping[str, str],
    drives: Drives,
    folder: StageFolder,
) -> set[Path]:
    """Train the networks of model `name`: in parallel on CPUs, one process each, and one after the
    other on a GPU.

    Arguments as of :func:`fit_run`. Returns the files of their states.
    """
    # A GPU trains one network at a time; a cluster has a worker per GPU, see CUDA_VISIBLE_DEVICES.
    alone = SCHEDULER not in os.environ and (torch.cuda.is_available() or default_workers() == 1)
    files = Files(drives[drive].graphs for drive in store.drives_in(splits, "train", "val"))
    job = partial(
        fit_run,
        name=name,
        where=where,
        entry=entry,
        settings=settings,
        splits=splits,
        drives=drives,
        files=files if alone else None,
        code=folder.code.hash(),
        kept=folder.kept,
    )
    if alone or len(todo) == 1:
        return {job(run) for run in todo}
    return {state for _, state in run_jobs(job, todo, folder.code, threads=1)}


def fit_run(
    run: runs.Run,
    name: str,
    where: str,
    entry: Entry,
    settings: Train,
    splits: Mapping[str, str],
    drives: Drives,
    files: Files | None,
    code: str,
    kept: Path,
) -> Path:
    """Train a network of model `name`, from the state of an earlier run if there is one; write
    best.pt and curve.csv.

    `where`: of the model's entry, for messages; `splits`: drive → split; `files`: open graph files,
    None: this process has none; `code`: its hash; `kept`: the folder of states, see StageFolder.
    Returns the file of the state. Raises InputError.
    """
    entry = entry.seeded(run.seed)
    scenes = runs.scenes(splits, run.seed, entry.scene)
    seen = {
        drive: replace(drives[drive], scene=drives[other].graphs) for drive, other in scenes.items()
    }
    usable = {
        drive: labelled for drive, labelled in seen.items() if labelled.has_window(entry.window)
    }
    train = [usable[drive] for drive in store.drives_in(splits, "train") if drive in usable]
    val = [usable[drive] for drive in store.drives_in(splits, "val") if drive in usable]
    device = "cuda" if torch.cuda.is_available() else "cpu"
    contents = train[0].contents
    if device == "cpu":
        torch.set_num_threads(1)  # sums of more threads differ, and with them the weights
    torch.backends.cudnn.allow_tf32 = False  # float32 also in convolutions
    torch.manual_seed(run.seed)
    with error_context(where=where):
        net = entry.build(**contents._asdict(), outputs=len(train[0].columns))
    net.to(device)
    paths = [
        *dict.fromkeys(
            path for drive in train + val for path in (drive.graphs, drive.labels, drive.scene)
        )
    ]
    inputs = {
        "entry": entry.model_dump(mode="json"),
        "train": settings.model_dump(exclude={"seeds"}),
        "seed": run.seed,
        "drives": [drive.name for drive in train],
        "val": [drive.name for drive in val],
    }
    metadata = {
        "kind": trained.KIND,
        "name": name,
        "seeds": settings.seeds,
        "contents": contents._asdict(),
        "settings": train[0].settings,
        "datasets": sorted({drive.settings.get("dataset", "unknown") for drive in train}),
        "fps": float(1 / np.median(np.concatenate([np.diff(drive.time_s) for drive in train]))),
        **inputs,
    }
    fitting = Fit(
        net,
        entry,
        settings,
        run.seed,
        train,
        val,
        files or Files(drive.scene for drive in train + val),
    )
    state = kept / f"{stage_key(code, inputs, paths)}.pt"
    fitting.run(state, f"{name} seed {run.seed}")
    best = {
        "scale": fitting.scale.content,
        "epoch": selected_epoch(fitting.curve),
        "net": fitting.best,
    }
    checkpoint.write(run.folder / "best.pt", metadata | best)
    pd.DataFrame(fitting.curve).to_csv(
        run.folder / "curve.csv", index=False, float_format="%.6g", lineterminator="\n"
    )
    return state
