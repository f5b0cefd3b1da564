"""Section ``ingest``: drives of each split, and what to read of them."""

import re
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from pipeline.base.params import SPLITS, Drive, ImageSize, Section

SAMPLE = "2026_01_"  # prefix of the drives that are rendered with `source: both`
_RANGE = re.compile(r"([0-9]{4}_[0-9]{2}_[0-9]{2}_drive_)([0-9]{4})\.\.([0-9]{4})")


class Drives(Section):
    """Drives of each split. 2026_01_01_drive_0001..0009 stands for the nine drives 1 to 9 of a date."""

    train: list[Drive] = Field(min_length=1)
    val: list[Drive] = []
    test: list[Drive] = Field(min_length=1)

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
    match = _RANGE.fullmatch(str(name))
    numbers = range(int(match[2]), int(match[3]) + 1) if match else ()
    return [f"{name[:17]}{number:04d}" for number in numbers] or [name]


class Reading(Section):
    """What is read of each recording, whatever its split."""

    image_size: ImageSize
    cameras: list[Annotated[int, Field(ge=0, le=3)]] = Field(min_length=1)
    lidar: bool
    on_damaged: Literal["fail", "skip"]


class Ingest(Reading):
    source: Literal["sample", "kitti", "both"]
    drives: Drives
    manifests: dict[Drive, str] = {}  # imported drive → hash of its manifest, see steer import

    def sources(self) -> dict[str, Literal["sample", "kitti"]]:
        """Return drive → source; with `both`, the name decides."""
        if self.source != "both":
            return dict.fromkeys(self.drives.splits(), self.source)
        return {drive: "sample" if drive.startswith(SAMPLE) else "kitti" for drive in self.drives.splits()}
