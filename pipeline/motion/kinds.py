"""The index of data/motion: the kinds of measured motion, each a folder with an index of drives."""

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from pydantic import BaseModel

from pipeline.base import store


class Index(BaseModel):
    """Content of index.json."""

    kinds: list[Literal["visual", "lidar"]]


def write(folder: Path, kinds: Iterable[str]) -> None:
    """Write ``index.json``; call it when the folder of each kind is complete."""
    store.write_json(folder / "index.json", {"schema": store.SCHEMA, "kinds": sorted(kinds)})


def read(folder: Path) -> dict[str, Path]:
    """Return kind → its folder. Raises InputError if the index or a drive's file is missing."""
    kinds = store.read_json(folder / "index.json", stage="motion", form=Index)["kinds"]
    for kind in kinds:
        store.read_index(folder / kind, stage="motion")
    return {kind: folder / kind for kind in kinds}
