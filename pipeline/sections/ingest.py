"""Section ``ingest``: which drives, and what is read of them."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pipeline.base.params import SPLITS, Drive, ImageSize, Section


class Drives(Section):
    """Which drives each split holds. `val` may be empty: then there is no early stopping."""

    train: list[Drive] = Field(min_length=1)
    val: list[Drive] = []
    test: list[Drive] = Field(min_length=1)

    @model_validator(mode="after")
    def _disjoint(self) -> Self:
        names = self.train + self.val + self.test
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"{', '.join(twice)} is named twice: a drive belongs to one split, once")
        return self

    def splits(self) -> dict[str, str]:
        """Return drive → split, in the order train, val, test."""
        return {drive: split for split in SPLITS for drive in getattr(self, split)}


SAMPLE = "2026_"
"""How the names of the embedded sample's drives begin; KITTI's begin with 2011_."""


class Ingest(Section):
    key = "ingest"
    source: Literal["town", "kitti", "both"]
    image_size: ImageSize
    cameras: list[Annotated[int, Field(ge=0, le=3)]] = Field(min_length=1)
    lidar: bool
    on_damaged: Literal["fail", "skip"]
    drives: Drives

    def sources(self) -> dict[str, Literal["town", "kitti"]]:
        """Return drive → where it comes from; of `both`, the sample's drives are told by their names."""
        if self.source != "both":
            return dict.fromkeys(self.drives.splits(), self.source)
        return {drive: "town" if drive.startswith(SAMPLE) else "kitti" for drive in self.drives.splits()}
