"""Which folder holds the run of which seed, of training and of judging alike."""

from collections.abc import Sequence
from pathlib import Path

_PREFIX = "seed-"


def folders(model: Path, seeds: Sequence[int]) -> dict[int, Path]:
    """Return the folder of each seed: the first one's files are the model's own, further ones get a folder in it."""
    return {seed: model / f"{_PREFIX}{seed}" if position else model for position, seed in enumerate(seeds)}


def model_name(folder: Path) -> str:
    """Return the name of the model whose run one of :func:`folders` holds."""
    own = folder.resolve()
    return own.parent.name if own.name.startswith(_PREFIX) else own.name
