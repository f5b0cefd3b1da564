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
    """Return the runs of a model.

    The first seed has the folder `model`, the others subfolders of it.
    """
    result = [Run(seed, model / f"seed-{seed}") for seed in seeds]
    result[0] = Run(seeds[0], model)
    return result


def check_splits(splits: Mapping[str, str], scene: str) -> None:
    """Raise InputError if a split has too few drives for the networks of a model.

    `splits` maps the name of a drive to its split.
    """
    if not store.drives_in(splits, "train"):
        raise InputError("there are no training drives", fix="Name some in ingest.drives.train")
    # Choosing scenes raises InputError if a split has a single drive, for any seed.
    scenes(splits, 0, scene)


def scenes(splits: Mapping[str, str], seed: int, scene: str) -> dict[str, str]:
    """Return for each drive the name of the drive whose scene it gets.

    With scene: same, it gets its own scene. With scene: another, it gets the scene of a random
    other drive of its split, which depends on the seed. Raises InputError if a split has only one
    drive.
    """
    if scene == "same":
        return {drive: drive for drive in splits}
    result = {}
    for split in SPLITS:
        drives = store.drives_in(splits, split)
        for drive in drives:
            choices = [choice for choice in drives if choice != drive]
            if not choices:
                problem = f"scene: another needs two drives that are used alike (got {drive} alone)"
                raise InputError(problem, fix="Add drives to its split")
            rng = np.random.default_rng([seed, crc32(drive.encode())])
            result[drive] = choices[rng.integers(len(choices))]
    return result
