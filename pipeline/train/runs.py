"""Which networks a model's line asks for: what each is fitted to and judged by, and which folder holds it.

A run is one network: a seed, and a fold. There is one fold with `fit_to: train`; with `others` or `both` there is one
for each test drive, whose network is fitted to the other test drives, and judges that one. With `others` there are no
validation drives either: they are of training's world, and would choose the epoch.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.params import Count, Section
from pipeline.base.resume import file_hash

_SEED, _FOLD = "seed-", "fold-"


class Line(Section):
    """What a trained model's line must say; the knobs of its networks, steering_net.build checks."""

    model_config = ConfigDict(extra="allow")

    input: str
    window: Count
    features: Count
    horizon: Annotated[int, Field(ge=0)]
    motion: str


class Config(BaseModel):
    """What config.json of a trained model says, as far as it is read again."""

    model: Line
    seeds: Annotated[list[int], Field(min_length=1)]
    parameters: int
    encode_ms_per_frame: float


@dataclass(frozen=True)
class Fold:
    """The drives of one network, by split: fitted to, validated by, judged by."""

    name: str | None  # the test drive that is left out of what is fitted to; None: no test drive is fitted to
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
        """What the log says of it, behind the model's name."""
        return f"seed {self.seed}" + (f" without {self.fold.name}" if self.fold.name else "")


def folds(splits: Mapping[str, str], line: Mapping[str, Any]) -> list[Fold]:
    """Return the folds that a model's line asks for, of drive → split.

    Raises InputError, which starts with the line's key, if there are fewer training drives than `roads`, or if nothing
    is left to fit to.
    """
    train, val, test = (tuple(store.of_split(splits, split)) for split in ("train", "val", "test"))
    fit_to, roads = line.get("fit_to", "train"), line.get("roads")  # an older config.json lacks them
    if roads is not None and roads > len(train):
        raise InputError(f"roads = {roads}: there are {len(train)} training drives")
    train = train[:roads]
    if fit_to == "train":
        return [Fold(None, train, val, test)]
    left, val = (train, val) if fit_to == "both" else ((), ())
    made = [Fold(drive, left + tuple(other for other in test if other != drive), val, (drive,)) for drive in test]
    if not made or not all(fold.train for fold in made):
        raise InputError(f"fit_to = {fit_to!r}: {', '.join(test) or 'none'} is the only test drive: name more of them")
    return made


def runs(model: Path, seeds: Sequence[int], folds: Sequence[Fold]) -> list[Run]:
    """Return all runs of a model, which has folder `model`: the folds of the first seed, then those of the next."""
    return [
        Run(seed, fold, folder / f"{_FOLD}{fold.name}" if fold.name else folder)
        for seed, folder in folders(model, seeds).items()
        for fold in folds
    ]


def folders(model: Path, seeds: Sequence[int]) -> dict[int, Path]:
    """Return the folder of each seed: the first one's files are the model's own, further ones get a folder in it."""
    return {seed: model / f"{_SEED}{seed}" if position else model for position, seed in enumerate(seeds)}


def check_pair(best: Path) -> None:
    """Raise InputError if a best.pt is not that of the config.json beside it, as where one of them was copied there.

    A best.pt alone is all that its network needs; an older config.json does not tell its hash.
    """
    config, name = best.with_name("config.json"), model_name(best.parent)
    if not config.is_file():
        return
    told = store.read_json(config, stage=f"train@{name}").get("best_sha256")
    if told not in (None, file_hash(best)):
        raise InputError(
            f"{best} is not the one that {config} was written for (its SHA-256 is another): one of them is of another "
            f"run. Train it again: dvc repro --force --single-item train@{name}"
        )


def model_name(folder: Path) -> str:
    """Return the name of the model that a run's folder belongs to."""
    own = folder.resolve()
    while own.name.startswith((_SEED, _FOLD)):
        own = own.parent
    return own.name
