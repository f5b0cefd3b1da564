"""Networks to train for a model, one per seed, and the drives whose scenes they get."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS


class Run(NamedTuple):
    """One network to train."""

    seed: int
    folder: Path


def runs(model: Path, seeds: Sequence[int]) -> list[Run]:
    """Return the runs of a model: that of the first seed in the folder `model`, the others in
    subfolders.
    """
    return [
        Run(seed, model / f"seed-{seed}" if position else model)
        for position, seed in enumerate(seeds)
    ]


def check(splits: Mapping[str, str], scene: str) -> None:
    """Raise InputError if drive → split has too few drives for the networks of a model."""
    if not store.drives_in(splits, "train"):
        raise InputError("there are no training drives", fix="Name some in ingest.drives.train")
    scenes(splits, 0, scene)


def scenes(splits: Mapping[str, str], seed: int, scene: str) -> dict[str, str]:
    """Return drive → drive whose scene it gets: its own, or with `scene` another one of its split,
    drawn once per seed.

    Raises InputError if a split has only one drive.
    """
    result = {}
    for split in SPLITS:
        drives = store.drives_in(splits, split)
        for drive in drives:
            others = (
                [other for other in drives if other != drive] if scene == "another" else [drive]
            )
            if not others:
                problem = f"scene: another needs two drives that are used alike (got {drive} alone)"
                raise InputError(problem, fix="Add drives to its split")
            result[drive] = others[
                np.random.default_rng([seed, crc32(drive.encode())]).integers(len(others))
            ]
    return result
