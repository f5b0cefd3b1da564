"""Train one run, from its drives to its folder: best.pt, last.pt, config.json, curve.csv."""

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
from pipeline.base.executors import default_workers
from pipeline.base.resume import file_hash, revision, stage_key
from pipeline.graphs import graph_file
from pipeline.settings.models import Entry
from pipeline.settings.train import Train
from pipeline.train import checkpoint, fit, predict
from pipeline.train.curve import selected_epoch, write_curve
from pipeline.train.distributed import World
from pipeline.train.labelled_drive import LabelledDrive, read_drives
from pipeline.train.path_target import PathTarget
from pipeline.train.runs import Run

SMALL = 8_000  # points per frame
# Estimated GPU memory of a training step, from the upper bounds in docs/running.md.
GPU_BYTES_PER_NETWORK = 10**9  # context, libraries, weights
GPU_BYTES_PER_POINT = 3_200
POINTS_OF_AN_IMAGE = 45_000


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
    files: dict[str, list[str]]  # training or validation drive → hashes of its files
    pending: Path  # folder for the states of interrupted runs

    def read_drives(self, names: tuple[str, ...]) -> list[LabelledDrive]:
        """Read drives with targets for this model."""
        return read_drives(self.variant, self.labels, names, self.entry.window, **self.entry.reading)

    def target(self, drives: list[LabelledDrive]) -> "predict.Target | PathTarget":
        """Return the scale of the outputs, from training drives. Raises InputError."""
        return (PathTarget if self.entry.predict == "path" else predict.Target).from_drives(drives)


def networks_at_once(job: Job, drive: str, device: torch.device) -> int | None:
    """Return how many networks a GPU trains at once, by its free memory and STEER_WORKERS; None for a CPU.

    Assumes that the frames of all drives have as many points as those of `drive`.
    """
    if device.type == "cpu":
        return None
    with graph_file.open_graphs(job.variant / f"{drive}.h5") as graphs:
        points = graphs.points_per_frame or POINTS_OF_AN_IMAGE
    frames = job.settings.batch_spans * (job.settings.span_windows + job.entry.window - 1)
    free_bytes, _ = torch.cuda.mem_get_info(device)
    fitting = int(free_bytes // (GPU_BYTES_PER_NETWORK + frames * points * GPU_BYTES_PER_POINT))
    return max(1, min(default_workers(), fitting))


def fit_run(
    run: Run, job: Job, world: World = World(), device: torch.device | str = "cpu", readers: int | None = None
) -> None:
    """Train one network, from an interrupted run's state if there is one, and write its folder.

    `readers`: processes that read its batches; None: as a Reader's default.
    Raises InputError: the network does not fit the graphs, the loss is not finite, or the processes of `world` differ
    in code, settings or files.
    """
    entry, settings, fold = job.entry, job.settings, run.fold
    train, val = job.read_drives(fold.train), job.read_drives(fold.val)
    with graph_file.open_graphs(train[0].graphs) as graphs:
        contents, points = graphs.contents, graphs.points_per_frame
    if torch.device(device).type == "cpu" and 0 < points < SMALL:
        # With few points a second thread has little to do, and slows each of a step's hundreds of small operations
        # where another process uses its core. One thread's sums are also the same on each machine.
        torch.set_num_threads(1)
    torch.manual_seed(run.seed)
    target = job.target(train)
    with error_context(where=job.where):
        net = entry.build(**contents.model_dump(), outputs=target.outputs)
    net.to(device, torch.float64 if settings.precision == "float64" else None)
    inputs = {
        "model": entry.model_dump(mode="json"),
        "train": settings.model_dump(exclude={"seeds"}),
        "seed": run.seed,
        "splits": job.splits,
        "fold": fold.name,
    }
    files = [digest for drive in fold.train + fold.val for digest in job.files[drive]]
    key = stage_key("train", inputs, files)
    if world.gather(key) != [key] * world.size:
        raise InputError(
            "processes differ in code, settings, graphs or labels", job.name, "Update all clones: git pull, dvc pull"
        )
    state = job.pending / f"{key}.pt"
    fitting = fit.Fit(net, entry.window, entry.alpha, settings, run.seed, world)
    metadata: dict[str, Any] = {
        "name": job.name,
        "contents": contents.model_dump(exclude_defaults=True),
        "target": vars(target),
        "revision": revision(),
        "card": predict.Card.from_drives(train).model_dump(),
        **inputs,
    }
    fitting.run(train, val, target, state, metadata, f"{job.name} {run}", readers)
    if entry.uncertainty and val:
        metadata["target"] = vars(fitting.calibrate(val, target))
    if world.is_main:
        figures = {
            "seeds": settings.seeds,
            "parameters": steering_net.parameter_count(net),
        }
        _write(run.folder, fitting, state, metadata, figures)


def _write(
    folder: Path, fitting: fit.Fit, state: Path, metadata: Mapping[str, Any], figures: Mapping[str, Any]
) -> None:
    """Write a run's files; `state` was written after its last epoch."""
    best = selected_epoch(fitting.curve)
    with replacing(folder / "last.pt") as tmp:
        shutil.copyfile(state, tmp)
    checkpoint.write(folder / "best.pt", {**metadata, "kind": predict.KIND, "epoch": best, "net": fitting.best})
    write_curve(folder / "curve.csv", fitting.curve)
    # Last: after a kill before this, best.pt and the earlier config.json are refused as a pair until the run completes.
    summary = {"best_epoch": best, "best_sha256": file_hash(folder / "best.pt"), "epochs": len(fitting.curve)}
    store.write_json(folder / "config.json", {**metadata, **summary, **figures})
