"""Declare section ``ingest``: the drives of each split, their datasets, and how they are read."""

import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from pipeline.base.errors import closest
from pipeline.base.params import SPLITS, ImageSize, Name, Section

# Names of the datasets: each is a file in pipeline/ingest/datasets.
DATASETS = sorted(path.stem for path in (Path(__file__).parent / "datasets").glob("[!_]*.py"))
# Pattern of the dates in the names of KITTI's drives, and of the sample's.
DATE = r"\d{4}_\d\d_\d\d"
# Dataset → pattern of the names of its drives. Imported drives have another name than a date.
NAMES = {"kitti": r".+_drive_\d{4}", "sample": rf"{DATE}_drive_\d{{4}}"}


class Drives(Section):
    """Drives of each split."""

    train: list[Name] = Field(
        default=[],
        description="training drives. 2026_01_01_drive_0001..0009 is the drives 1 to 9 of a date",
    )
    val: list[Name] = Field(
        default=[],
        description="validation drives, which choose the epoch. Without any, it is the last one",
    )
    test: list[Name] = Field(min_length=1, description="test drives, on which nothing is chosen")

    @field_validator(*SPLITS, mode="before")
    @classmethod
    def _expand_ranges(cls, names: object) -> object:
        if not isinstance(names, list):
            return names
        return [drive for name in names for drive in _expand_range(name)]

    @model_validator(mode="after")
    def _check_disjoint(self) -> Self:
        names = self.train + self.val + self.test
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(
                f"{', '.join(twice)} is listed more than once (expected one split per drive)"
            )
        return self

    def splits(self) -> dict[str, str]:
        """Return drive → split, in the order train, val, test."""
        return {drive: split for split in SPLITS for drive in getattr(self, split)}


def _expand_range(name: object) -> list[object]:
    """Return the drives of a range. Any other name stays, and so does an empty range."""
    match = re.fullmatch(r"(.*?)([0-9]+)\.\.([0-9]+)", str(name))
    if not match or len(match[2]) != len(match[3]):
        return [name]
    beginning, first, last = match.groups()
    numbers = range(int(first), int(last) + 1)
    return [f"{beginning}{number:0{len(first)}d}" for number in numbers] or [name]


class Reading(Section):
    """The settings by which each drive is read, whatever its split."""

    image_size: ImageSize = Field(
        description="[height, width] of the resized images in pixels. The paper's CNN has "
        "[192, 640]"
    )
    cameras: list[Annotated[int, Field(ge=0, le=3)]] = Field(
        min_length=1,
        description="KITTI's numbers of cameras, of which the first that a drive has is read. 0 is "
        "left grey, 1 right grey, 2 left colour, 3 right colour",
    )
    lidar: bool = Field(description="whether scans are read, for variants with `clouds/lidar`")
    on_damaged: Literal["fail", "skip"] = Field(
        description="what a damaged file of a frame does: `fail` stops the stage, `skip` leaves "
        "the file out and counts it"
    )


class Ingest(Reading):
    """Section ``ingest``."""

    source: str = Field(
        json_schema_extra={"enum": [*DATASETS]},
        description="dataset, a file of `pipeline/ingest/datasets/`",
    )
    drives: Drives
    imports_sha256: str | None = Field(
        default=None,
        description="hash of the imports that the drives are of. `make NAME` writes it, so that "
        "DVC notices another one",
    )

    @model_validator(mode="after")
    def _check_source(self) -> Self:
        if self.source not in DATASETS:
            raise ValueError(
                f"source: there is no pipeline/ingest/datasets/{self.source}.py "
                f"({closest(self.source, DATASETS)})"
            )
        for drive in self.drives.splits():
            if not re.fullmatch(NAMES.get(self.source, ".*"), drive):
                raise ValueError(
                    "drives: expected a drive's name, such as 2011_09_26_drive_0052 "
                    f"(got {drive!r})"
                )
        return self
