"""Train one model on its graph variant: data/train/<model>/{best.pt, curve.csv}."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.base import console, store
from pipeline.base.errors import error_context
from pipeline.base.outputs import stage_folder
from pipeline.base.params import SPLITS, load, load_entry
from pipeline.train import runs
from pipeline.train.entry import Entry
from pipeline.train.fit_model import fit_model
from pipeline.train.loss import Scale
from pipeline.train.settings import Train
from pipeline.train.targets import check, rate_doubt, read_drive


def main(
    name: Annotated[
        str, typer.Argument(metavar="MODEL", help="an entry of models in the params file")
    ],
    data: Path = Path("data"),
    out: Annotated[Path, typer.Option(help="parent of the model's folder")] = Path("data/train"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Train the model, stop early when the validation error stops falling, and keep the best epoch.

    One network per seed: in parallel on CPUs, one process each, and one after the other on a GPU.
    Returns the model's folder.
    """
    settings = load(Train, params)
    entry = load_entry(Entry, "models", name, params)
    settings = settings.model_copy(
        update={"learning_rate": entry.learning_rate or settings.learning_rate}
    )
    variant = data / "graphs" / entry.input
    with stage_folder(f"train@{name}", out / name, params=params, own=entry.networks) as folder:
        splits = store.read_index(variant, stage="graphs")
        where = f"{params}: models.{name}"
        with error_context(where=where):
            runs.check(splits, entry.scene)
        parts = {split: store.drives_in(splits, split) for split in SPLITS}
        names = [drive for part in parts.values() for drive in part]
        drives = {drive: read_drive(variant, data / "labels", drive, entry) for drive in names}

        # Errors before the first network is trained.
        for part in filter(None, parts.values()):
            check([drives[drive] for drive in part], entry.window)
        Scale.from_drives([drives[drive] for drive in parts["train"]])
        if doubt := rate_doubt(drives, parts["train"]):
            print(f"{name}: {doubt}", flush=True)
        if not parts["val"]:
            print(
                f"{name}: no validation drives, so no early stopping: keeps the last epoch",
                flush=True,
            )

        todo = runs.runs(folder.new, settings.seeds)
        folder.used.update(fit_model(todo, name, where, entry, settings, splits, drives, folder))
        # of all code and settings: small, and costly to make
        folder.used.update(folder.kept.glob("*.pt"))
    return out / name


if __name__ == "__main__":
    console.run(main)
