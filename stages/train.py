"""Train one model on its graph variant: data/train/<model>/{best.pt, last.pt, config.json, curve.csv}.

On several GPUs: torchrun --nproc-per-node 2 -m stages.train MODEL; all processes must see the same files.
"""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pipeline.base import console, provenance, store
from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS, load, load_entry
from pipeline.base.resume import resume_key
from pipeline.fitting import checkpoint
from pipeline.sections.models import Model
from pipeline.sections.train import Train
from pipeline.train import frames, windows

if TYPE_CHECKING:
    from models.steering.core.steering_net import SteeringNet
    from pipeline.train.fit import Fit


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models: in the params file")],
    graphs: Path = Path("data/graphs"),
    labels: Path = Path("data/labels"),
    out: Annotated[Path, typer.Option(help="the model gets a folder in it")] = Path("data/train"),
    params: Path = Path("params.yaml"),
) -> None:
    """Fit the model to the training drives, stop when the validation error no longer falls, keep the best epoch."""
    import torch

    from models.steering.core import steering_net
    from pipeline.train import distributed
    from pipeline.train import fit as steering_fit

    line, section = load_entry(Model, "models", name, params), load(Train, params)
    section = section.model_copy(update={"learning_rate": line.learning_rate or section.learning_rate})
    variant = graphs / line.input
    splits = store.read_index(variant, stage="graphs")
    # The test drives are read too, only to find out now, not after training, that this model has no frame in them.
    train, val, _ = (
        windows.read_drives(variant, labels, store.of_split(splits, split), line.window) for split in SPLITS
    )
    files = [file for drive in train + val for file in (drive.graphs, drive.labels)]
    kept = out.parent / ".resume" / f"{out.name}-{name}"
    with distributed.joined() as (world, device):
        if world.size > section.batch_runs:
            raise InputError(
                f"{params}: train.batch_runs = {section.batch_runs}: the runs of a step cannot be spread over "
                f"{world.size} processes: raise it, or start fewer"
            )
        if not val and world.leads:
            print(f"{name}: no validation drives, so no early stopping: the last epoch counts as the best", flush=True)
        for seed, folder in steering_fit.folders(out / name, section.seeds).items():
            torch.manual_seed(seed)
            net = _build(name, line, train[0].graphs).to(
                device, torch.float64 if section.precision == "float64" else None
            )
            fit = steering_fit.Fit(net, steering_net.predict, line.window, line.alpha, section, seed, world)
            settings = {"model": line.model_dump(), "train": section.model_dump(exclude={"seeds"}), "seed": seed}
            about = {
                "name": name,
                "splits": splits,
                "target": vars(steering_fit.Target.of(train)),
                "revision": provenance.revision(),
                **settings,
            }
            state = kept / f"{resume_key('stages.train', settings | {'splits': splits}, files)}.pt"
            fit.run(train, val, state, about, f"{name} seed {seed}")
            if world.leads:
                more = {
                    "seeds": section.seeds,
                    "effective_frames": steering_fit.effective_frames(train, line.alpha),
                    "parameters": steering_net.parameter_count(net),
                    # Measured here, so that stage evaluate has no clock in its files.
                    "encode_ms_per_frame": steering_fit.ms_per_frame(
                        net, steering_net.encode, val or train, line.window
                    ),
                }
                _write(folder, fit, state, about, more)
    if world.leads:
        shutil.rmtree(kept)


def _build(name: str, line: Model, graphs: Path) -> "SteeringNet":
    from models.steering.core import steering_net

    try:
        return steering_net.build(line.model_dump(), **frames.contents(graphs))
    except ValueError as error:
        raise InputError(f"models.{name}: {error}") from error


def _write(folder: Path, fit: "Fit", state: Path, about: Mapping[str, Any], more: Mapping[str, Any]) -> None:
    """Write a finished run's files; `state` is what its last epoch left."""
    from pipeline.train import fit as steering_fit

    best = steering_fit.best_epoch(fit.curve)
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(state, folder / "last.pt")
    checkpoint.write(folder / "best.pt", {**about, "kind": steering_fit.KIND, "epoch": best, "net": fit.best})
    steering_fit.write_curve(folder / "curve.csv", fit.curve)
    store.write_json(folder / "config.json", {**about, "best_epoch": best, "epochs": len(fit.curve), **more})


if __name__ == "__main__":
    console.run(main)
