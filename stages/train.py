"""Train one model on its graph variant: data/train/<model>/{best.pt, last.pt, config.json, curve.csv}.

On several GPUs: torchrun --nproc-per-node 2 -m stages.train MODEL; all processes must see the same files.
"""

import shutil
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pipeline.base import console, provenance, store
from pipeline.base.errors import InputError, explained
from pipeline.base.lock import held
from pipeline.base.params import SPLITS, load, load_entry
from pipeline.base.resume import resume_key
from pipeline.fitting import checkpoint
from pipeline.sections.models import Model
from pipeline.sections.train import Train
from pipeline.train import distributed, frames, predict, seeds, windows

if TYPE_CHECKING:
    from pipeline.train.fit import Fit


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models: in the params file")],
    graphs: Path = Path("data/graphs"),
    labels: Path = Path("data/labels"),
    out: Annotated[Path, typer.Option(help="the model gets a folder in it")] = Path("data/train"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Fit the model to the training drives, stop when the validation error no longer falls, keep the best epoch.

    Returns the model's folder.
    """
    import torch

    from models.steering.core import steering_net
    from pipeline.train import fit

    model, settings = load_entry(Model, "models", name, params), load(Train, params)
    settings = settings.model_copy(update={"learning_rate": model.learning_rate or settings.learning_rate})
    with explained(where=f"{params}: models.{name}"):
        line = steering_net.resolved(model.model_dump())
    variant = graphs / model.input
    splits = store.read_index(variant, stage="graphs")
    # The test drives are read too, only to find out now, not after training, that this model has no frame in them.
    train, val, _ = (
        windows.read_drives(variant, labels, store.of_split(splits, split), model.window) for split in SPLITS
    )
    modules = ["stages.train", *steering_net.modules(line)]
    contents = frames.contents(train[0].graphs)
    files = [file for drive in train + val for file in (drive.graphs, drive.labels)]
    kept = out.parent / ".resume" / f"{out.name}-{name}"
    with distributed.joined() as (world, device), held(out / name, kept) if world.leads else nullcontext():
        if world.size > settings.batch_runs:
            raise InputError(
                f"{params}: train.batch_runs = {settings.batch_runs}: the runs of a step cannot be spread over "
                f"{world.size} processes: raise it, or start fewer"
            )
        if not val and world.leads:
            print(f"{name}: no validation drives, so no early stopping: the last epoch counts as the best", flush=True)
        for seed, folder in seeds.folders(out / name, settings.seeds).items():
            torch.manual_seed(seed)
            with explained(where=f"{params}: models.{name}"):
                net = steering_net.build(line, **contents)
            net.to(device, torch.float64 if settings.precision == "float64" else None)
            run = fit.Fit(net, steering_net.predict, model.window, model.alpha, settings, seed, world)
            determined_by = {"model": line, "train": settings.model_dump(exclude={"seeds"}), "seed": seed}
            about = {
                "name": name,
                "splits": splits,
                "contents": contents,
                "target": vars(predict.Target.of(train)),
                "revision": provenance.revision(),
                **determined_by,
            }
            state = kept / f"{resume_key(modules, determined_by | {'splits': splits}, files)}.pt"
            run.run(train, val, state, about, f"{name} seed {seed}")
            if world.leads:
                more = {
                    "seeds": settings.seeds,
                    "effective_frames": fit.effective_frames(train, model.alpha),
                    "parameters": steering_net.parameter_count(net),
                    # Measured here, so that stage evaluate has no clock in its files.
                    "encode_ms_per_frame": predict.ms_per_frame(net, steering_net.encode, val or train, model.window),
                }
                _write(folder, run, state, about, more)
    if world.leads:
        shutil.rmtree(kept)
    return out / name


def _write(folder: Path, run: "Fit", state: Path, about: Mapping[str, Any], more: Mapping[str, Any]) -> None:
    """Write a finished run's files; `state` is what its last epoch left."""
    from pipeline.train import fit

    best = fit.kept_epoch(run.curve, run.settings.keep)
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(state, folder / "last.pt")
    checkpoint.write(folder / "best.pt", {**about, "kind": predict.KIND, "epoch": best, "net": run.best})
    fit.write_curve(folder / "curve.csv", run.curve)
    store.write_json(folder / "config.json", {**about, "best_epoch": best, "epochs": len(run.curve), **more})


if __name__ == "__main__":
    console.run(main)
