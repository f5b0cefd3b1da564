"""Networks to train for a model, one per seed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from pipeline.base.errors import InputError


class Run(NamedTuple):
    """One network to train."""

    seed: int
    folder: Path


def list_runs(model: Path, seeds: Sequence[int]) -> list[Run]:
    """Return the runs of a model.

    The first seed has the folder `model`, the others subfolders of it.
    """
    result = [Run(seed, model / f"seed-{seed}") for seed in seeds]
    result[0] = Run(seeds[0], model)
    return result


def check_splits(splits: Mapping[str, str]) -> None:
    """Raise InputError if no drive is in the split train. `splits` is drive → split."""
    if "train" not in splits.values():
        raise InputError("there are no training drives", fix="Name some in ingest.drives.train")
