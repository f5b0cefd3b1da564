"""One training run, from its drives to its folder: best.pt, last.pt, config.json, curve.csv."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from models.steering.core import steering_net
from pipeline.base import store
from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError, error_context
from pipeline.base.resume import file_hash, revision, stage_key
from pipeline.fitting import checkpoint
from pipeline.sections.train import Train
from pipeline.train import fit, frames, predict, windows
from pipeline.train.curve import kept_epoch, write_curve
from pipeline.train.distributed import World
from pipeline.train.runs import Run

SMALL = 8_000  # points a frame


@dataclass(frozen=True)
class Job:
    """What all runs of a model share."""

    name: str
    where: str  # its line stands, for messages
    line: dict[str, Any]  # as resolved
    settings: Train
    variant: Path  # folder of graphs
    labels: Path
    splits: dict[str, str]  # drive → split
    files: dict[str, list[str]]  # drive that is learned from → hashes of its files
    kept: Path  # where runs keep what they have, for the next time


def fit_run(run: Run, job: Job, world: World = World(), device: torch.device | str = "cpu") -> None:
    """Fit one network, going on from what a killed process kept of it, and write its folder.

    Raises InputError: the network is not made for these graphs, or its loss is no longer finite; processes that share
    the run have not the same code, settings or files.
    """
    line, settings, fold = job.line, job.settings, run.fold
    train, val = (
        windows.read_drives(job.variant, job.labels, drives, line["window"], line["horizon"], line["motion"])
        for drives in (fold.train, fold.val)
    )
    contents = frames.contents(train[0].graphs)
    if torch.device(device).type == "cpu":
        torch.set_num_threads(threads(train[0].graphs))
    torch.manual_seed(run.seed)
    with error_context(where=job.where):
        net = steering_net.build(line, **contents)
    net.to(device, torch.float64 if settings.precision == "float64" else None)
    determined_by = {
        "model": line,
        "train": settings.model_dump(exclude={"seeds"}),
        "seed": run.seed,
        "splits": job.splits,
        "fold": fold.name,
    }
    files = [digest for drive in fold.train + fold.val for digest in job.files[drive]]
    key = stage_key("train", determined_by, files)
    if world.gather(key) != [key] * world.size:
        raise InputError(
            f"{job.name}: the processes have not all the same code, settings, graphs and labels: bring the clones on "
            "all machines to one state (git pull, dvc pull), and start again"
        )
    state = job.kept / f"{key}.pt"
    fitting = fit.Fit(net, steering_net.predict, line["window"], line["alpha"], settings, run.seed, world)
    about = {
        "name": job.name,
        "contents": contents,
        "target": vars(predict.Target.of(train)),
        "revision": revision(),
        **determined_by,
    }
    fitting.run(train, val, state, about, f"{job.name} {run}")
    if world.leads:
        more = {
            "seeds": settings.seeds,
            "effective_frames": fit.effective_frames(train, line["alpha"]),
            "parameters": steering_net.parameter_count(net),
        }
        _write(run.folder, fitting, state, about, more)


def threads(graphs: Path) -> int:
    """Return how many threads help to train on frames as in a graph file.

    On few points a second thread has next to nothing to do, and where another process has its core, each of a step's
    hundreds of small operations waits for it. One thread's sums are the same on any machine, besides.
    """
    with frames.open_graphs(graphs) as file:
        return 1 if 0 < file.points_per_frame < SMALL else torch.get_num_threads()


def ms_per_frame(run: Run, job: Job, device: torch.device | str) -> float:
    """Return the time in which a finished run's network encodes a frame, in ms.

    To be measured when nothing trains beside it, and by training, so that stage evaluate has no clock in its files.
    """
    line, fold = job.line, run.fold
    drives = [windows.read_drive(job.variant, job.labels, name) for name in fold.val or fold.train]
    return predict.ms_per_frame(predict.load(run.folder, device).net, steering_net.encode, drives, line["window"])


def _write(folder: Path, fitting: fit.Fit, state: Path, about: Mapping[str, Any], more: Mapping[str, Any]) -> None:
    """Write a finished run's files; `state` is what its last epoch left."""
    best = kept_epoch(fitting.curve, fitting.settings.keep)
    with replacing(folder / "last.pt") as tmp:
        shutil.copyfile(state, tmp)
    checkpoint.write(folder / "best.pt", {**about, "kind": predict.KIND, "epoch": best, "net": fitting.best})
    write_curve(folder / "curve.csv", fitting.curve)
    # Last: a run that is killed before it leaves a pair that is refused, and mended as it goes on.
    figures = {"best_epoch": best, "best_sha256": file_hash(folder / "best.pt"), "epochs": len(fitting.curve)}
    store.write_json(folder / "config.json", {**about, **figures, **more})
