"""Networks to train for a model: seeds and folds, their drives and their folders.

A run is one network: a seed and a fold. `fit_to: train` has one fold. `others` and `both` are leave-one-out: one fold
per test drive, trained on the other test drives and evaluated on this one. `others` has no validation drives:
they are from the training drives' world, which `others` leaves out completely.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.base import store
from pipeline.base.errors import InputError


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


def runs(model: Path, seeds: Sequence[int], folds: Sequence[Fold]) -> list[Run]:
    """Return all runs of the model with folder `model`: the folds of the first seed, then those of the next."""
    return [
        Run(seed, fold, folder / f"fold-{fold.name}" if fold.name else folder)
        for seed, folder in folders(model, seeds).items()
        for fold in folds
    ]


def folders(model: Path, seeds: Sequence[int]) -> dict[int, Path]:
    """Return the folder of each seed: `model` for the first one, subfolders for the others."""
    return {seed: model / f"seed-{seed}" if position else model for position, seed in enumerate(seeds)}
