"""Networks to train for a model: seeds and folds, their drives and their folders.

A run is one network: a seed and a fold. `fit_to: train` has one fold. `others` and `both` are leave-one-out: one fold
per test drive, trained on the other test drives and evaluated on this one. `others` has no validation drives:
they are from the training drives' world, which `others` leaves out completely.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, Field

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.resume import file_hash
from pipeline.settings.models import Entry
from pipeline.train.labelled_drive import read_drive, target_fault

_SEED, _FOLD = "seed-", "fold-"


class Config(BaseModel):
    """Schema of a trained model's config.json, as far as it is read."""

    model: Entry
    seeds: Annotated[list[int], Field(min_length=1)]
    parameters: int
    best_sha256: str | None = None  # None: not verified


@dataclass(frozen=True)
class Fold:
    """Training, validation and test drives of one network."""

    name: str | None  # the test drive that is not used for training; None: none is
    train: tuple[str, ...]
    val: tuple[str, ...]
    test: tuple[str, ...]


@dataclass(frozen=True)
class Run:
    """One network to train."""

    seed: int
    fold: Fold
    folder: Path

    def __str__(self) -> str:
        """Return seed and fold, for the log."""
        return f"seed {self.seed}" + (f" without {self.fold.name}" if self.fold.name else "")


def folds(splits: Mapping[str, str], fit_to: str, roads: int | None) -> list[Fold]:
    """Return the folds of a model with these keys of its entry, from drive → split.

    Raises InputError if there are fewer training drives than `roads`, or if a fold has no training drive.
    """
    train, val, test = (tuple(store.drives_in(splits, split)) for split in ("train", "val", "test"))
    if roads is not None and roads > len(train):
        raise InputError(f"roads = {roads}, but there are {len(train)} training drives")
    train = train[:roads]
    if fit_to == "train":
        return [Fold(None, train, val, test)]
    train, val = (train, val) if fit_to == "both" else ((), ())
    result = [Fold(drive, train + tuple(other for other in test if other != drive), val, (drive,)) for drive in test]
    if not result or not all(fold.train for fold in result):
        names = ", ".join(test) or "none"
        raise InputError(f"fit_to = {fit_to!r} needs two test drives (got {names})", fix="Add drives to the split test")
    return result


def drop_untestable(folds: Sequence[Fold], graphs: Path, labels: Path, entry: Entry) -> list[Fold]:
    """Return the folds with valid test targets, and print the others. Their test drives still train other folds.

    Args:
        graphs: folder of the variant.
    Raises:
        InputError: no fold is left; or as :func:`read_drive`.
    """
    testable, faults = [], []
    for fold in folds:
        drives = [read_drive(graphs, labels, name, **entry.reading) for name in fold.test]
        if fault := target_fault(drives, entry.window):
            faults.append(fault)
        else:
            testable.append(fold)
    if not testable:
        raise faults[0]
    for fault in faults:
        print(f"not evaluated: {fault}", flush=True)
    return testable


def runs(model: Path, seeds: Sequence[int], folds: Sequence[Fold]) -> list[Run]:
    """Return all runs of the model with folder `model`: the folds of the first seed, then those of the next."""
    return [
        Run(seed, fold, folder / f"{_FOLD}{fold.name}" if fold.name else folder)
        for seed, folder in folders(model, seeds).items()
        for fold in folds
    ]


def folders(model: Path, seeds: Sequence[int]) -> dict[int, Path]:
    """Return the folder of each seed: `model` for the first one, subfolders for the others."""
    return {seed: model / f"{_SEED}{seed}" if position else model for position, seed in enumerate(seeds)}


def read_config(folder: Path) -> Config:
    """Read the config.json of a trained model. Raises InputError."""
    content = store.read_json(folder / "config.json", stage=f"train@{model_name(folder)}", form=Config)
    return Config.model_validate(content)


def check_pair(best: Path) -> None:
    """Raise InputError if best.pt and the config.json beside it are of different runs. config.json may be missing."""
    config, name = best.with_name("config.json"), model_name(best.parent)
    if not config.is_file():
        return
    expected = read_config(best.parent).best_sha256
    if expected and expected != file_hash(best):
        raise InputError(
            f"best.pt and {config} are of different runs (SHA-256 differs)",
            best,
            f"Train the model again: dvc repro --force --single-item train@{name}",
        )


def model_name(folder: Path) -> str:
    """Return the model's name, from the folder of one of its runs."""
    folder = Path(os.path.realpath(folder))  # unlike resolve(), a symlink loop is no error
    while folder.name.startswith((_SEED, _FOLD)):
        folder = folder.parent
    return folder.name
