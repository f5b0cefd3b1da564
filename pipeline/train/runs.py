"""Networks to train for a model: seeds and folds, their drives and their folders.

A run is one network: a seed and a fold. `fit_to: train` has one fold. `others` is leave-one-out: one fold per test
drive, trained on the other test drives and evaluated on this one. These folds have no validation drives, which are from
the training drives' world. With `train-then-others` they start from a network of the training drives, one per seed.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.settings.models import Entry


class Fold(NamedTuple):
    """Training, validation and test drives of one network."""

    name: str | None  # the test drive that is not used for training; None: none is
    train: tuple[str, ...]
    val: tuple[str, ...]
    test: tuple[str, ...]
    start: "Fold | None" = None  # the fold from whose network this one's starts; None: random weights


class Run(NamedTuple):
    """One network to train."""

    seed: int
    fold: Fold
    folder: Path

    @property
    def start(self) -> "Run | None":
        """The run from whose weights this one starts."""
        start = self.fold.start
        return Run(self.seed, start, self.folder.parent / "first") if start else None

    def __str__(self) -> str:
        return f"seed {self.seed}" + (f" without {self.fold.name}" if self.fold.name else "")


def folds(splits: Mapping[str, str], entry: Entry) -> list[Fold]:
    """Return the folds of a model, from drive → split. Raises InputError if a split has too few drives for them."""
    fit_to = entry.fit_to
    train, val, test = (tuple(store.drives_in(splits, split)) for split in ("train", "val", "test"))
    if not train and fit_to != "others":
        raise InputError("there are no training drives", fix="Name some in ingest.drives.train")
    result = [Fold(None, train, val, test)]
    if fit_to != "train":
        start = Fold(None, train, val, ()) if fit_to == "train-then-others" else None
        result = [Fold(drive, tuple(name for name in test if name != drive), (), (drive,), start) for drive in test]
        if len(test) < 2:
            problem = f"fit_to = {fit_to!r} needs two test drives (got {', '.join(test) or 'none'})"
            raise InputError(problem, fix="Add drives to the split test")
    for fold in filter(None, (result[0].start, *result)):
        scenes(fold, 0, entry.scene)
    return result


def scenes(fold: Fold, seed: int, scene: str) -> dict[str, str]:
    """Return drive → drive whose scene it gets: its own, or with `scene` another one of its split, drawn once per seed.

    The test drive of a fold gets one on which its network was trained. Raises InputError if there is none.
    """
    tested = fold.test if fold.name is None else fold.train + fold.test
    result = {}
    for drives, split in ((fold.train, fold.train), (fold.val, fold.val), (fold.test, tested)):
        for drive in drives:
            others = [other for other in split if other != drive] if scene == "another" else [drive]
            if not others:
                problem = f"scene: another needs two drives that are used alike (got {drive} alone)"
                raise InputError(problem, fix="Add drives to its split")
            result[drive] = others[np.random.default_rng([seed, crc32(drive.encode())]).integers(len(others))]
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
