"""Train one model on its graph variant: data/train/<model>/{best.pt, last.pt, config.json, curve.csv}."""

import shutil
from pathlib import Path
from typing import Annotated

import typer

from pipeline import checkpoint, code, console, drives, frames, store, windows
from pipeline.errors import InputError
from pipeline.params import SPLITS, load, load_entry
from pipeline.sections.models import Model
from pipeline.sections.train import Train


def main(
    name: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models: in the params file")],
    graphs: Path = Path("data/graphs"),
    labels: Path = Path("data/labels"),
    out: Annotated[Path, typer.Option(help="the model gets a folder in it")] = Path("data/train"),
    params: Path = Path("params.yaml"),
) -> None:
    """Fit the model to the training drives, stop when the validation error no longer falls, keep the best epoch."""
    line, section = load_entry(Model, "models", name, params), load(Train, params)
    variant = graphs / line.input
    splits = store.read_index(variant, stage="graphs")
    # The test drives are read too, only to find out now, not after training, that this model has no frame in them.
    train, val, _ = (
        windows.read_drives(variant, labels, store.of_split(splits, split), line.window) for split in SPLITS
    )
    if not val:
        print(f"{name}: no validation drives, so no early stopping: the last epoch counts as the best", flush=True)
    kept = out.parent / ".resume" / f"{out.name}-{name}"
    for position, seed in enumerate(section.seeds):
        # The first seed's files are the model's; further seeds tell how much its figures vary.
        folder = out / name / (f"seed-{seed}" if position else "")
        _train(name, line, section, seed, splits, train, val, folder, kept)
    shutil.rmtree(kept)


def _train(
    name: str,
    line: Model,
    section: Train,
    seed: int,
    splits: dict[str, str],
    train: list[windows.Drive],
    val: list[windows.Drive],
    folder: Path,
    kept: Path,
) -> None:
    import torch

    from models import steering_net
    from pipeline import steering_fit

    torch.manual_seed(seed)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        net = steering_net.build(line.model_dump(), **frames.contents(train[0].graphs)).to(device)
    except ValueError as error:
        raise InputError(f"models.{name}: {error}") from error
    fit = steering_fit.Fit(net, steering_net.predict, line.window, line.alpha, section, seed)
    settings = {"model": line.model_dump(), "train": section.model_dump(exclude={"seeds"}), "seed": seed}
    files = [drive.graphs for drive in train + val] + [drive.labels for drive in train + val]
    state = kept / f"{drives.resume_key('stages.train', settings | {'splits': splits}, files)}.pt"
    target = vars(steering_fit.Target.of(train))
    about = {"name": name, "splits": splits, "target": target, "revision": code.revision(), **settings}
    fit.run(train, val, state, about, f"{name} seed {seed}")
    best = steering_fit.best_epoch(fit.curve)
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(state, folder / "last.pt")
    checkpoint.write(folder / "best.pt", {**about, "kind": steering_fit.KIND, "epoch": best, "net": fit.best})
    steering_fit.write_curve(folder / "curve.csv", fit.curve)
    store.write_json(
        folder / "config.json",
        about
        | {
            "best_epoch": best,
            "epochs": len(fit.curve),
            "effective_frames": steering_fit.effective_frames(train, line.alpha),
            "parameters": steering_net.parameter_count(net),
            # Measured here, so that stage evaluate has no clock in its files.
            "encode_ms_per_frame": steering_fit.ms_per_frame(net, steering_net.encode, val or train, line.window),
        },
    )


if __name__ == "__main__":
    console.run(main)
