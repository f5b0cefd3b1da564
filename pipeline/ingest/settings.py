"""Section ``ingest``: drives of each split, their datasets, and what to read of them."""

import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from pipeline.base.errors import closest
from pipeline.base.params import SPLITS, ImageSize, Name, Positive, Section

RECORDING = "recording"
DATASETS = sorted(path.stem for path in (Path(__file__).parent / "datasets").glob("[!_]*.py"))
KITTI_NAMES = re.compile(r"\d{4}_\d\d_\d\d_drive_\d{4}")  # also of the sample


class Drives(Section):
    """Drives of each split. 2026_01_01_drive_0001..0009 stands for the nine drives 1 to 9 of a date."""

    train: list[Name] = []
    val: list[Name] = []
    test: list[Name] = Field(min_length=1)

    @field_validator(*SPLITS, mode="before")
    @classmethod
    def _expand(cls, names: Any) -> Any:
        return [drive for name in names for drive in _expand_range(name)] if isinstance(names, list) else names

    @model_validator(mode="after")
    def _disjoint(self) -> Self:
        names = self.train + self.val + self.test
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"{', '.join(twice)} is listed more than once (expected one split per drive)")
        return self

    def splits(self) -> dict[str, str]:
        """Return drive → split, in the order train, val, test."""
        return {drive: split for split in SPLITS for drive in getattr(self, split)}


def _expand_range(name: Any) -> list[Any]:
    """Return the drives of a range. Any other name stays, and an empty range, which is no drive's name."""
    match = re.fullmatch(r"(.*?)([0-9]+)\.\.([0-9]+)", str(name))
    if not match or len(match[2]) != len(match[3]):
        return [name]
    numbers = range(int(match[2]), int(match[3]) + 1)
    return [f"{match[1]}{number:0{len(match[2])}d}" for number in numbers] or [name]


class Part(Section):
    """A part of a recording; `steer import` writes these. Options as of that command."""

    folder: Name  # of data/raw
    fov: float | None = None
    K: str | None = None
    distortion: str | None = None
    fisheye: str | None = None
    fps: float | None = None
    steering_ratio: float | None = None
    offset: float = 0.0
    horizon: float | None = None  # row of the complete images
    camera_height: Positive | None = None
    start: float = 0.0  # seconds since the first image
    end: float | None = None
    files: dict[str, str]  # name in the folder → SHA-256


class Reading(Section):
    """What is read of each drive, whatever its split."""

    image_size: ImageSize
    cameras: list[Annotated[int, Field(ge=0, le=3)]] = Field(min_length=1)
    lidar: bool
    on_damaged: Literal["fail", "skip"]


class Ingest(Reading):
    source: str  # a file of pipeline/ingest/datasets
    drives: Drives
    recordings: dict[Name, Part] = {}  # drives of another dataset than source

    @model_validator(mode="after")
    def _check_datasets(self) -> Self:
        for drive, dataset in self.datasets().items():
            if dataset not in DATASETS:
                raise ValueError(
                    f"source: there is no pipeline/ingest/datasets/{dataset}.py ({closest(dataset, DATASETS)})"
                )
            if dataset == RECORDING and drive not in self.recordings:
                raise ValueError(f"{drive} has no entry in recordings: steer import writes them")
            if dataset in ("kitti", "sample") and not KITTI_NAMES.fullmatch(drive):
                raise ValueError(f"drives: expected a drive's name, such as 2011_09_26_drive_0052 (got {drive!r})")
        return self

    def datasets(self) -> dict[str, str]:
        """Return drive → dataset, a file of pipeline/ingest/datasets; recordings are those of `recordings`."""
        return {drive: RECORDING if drive in self.recordings else self.source for drive in self.drives.splits()}
