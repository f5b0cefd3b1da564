"""The index of data/motion: which kinds of measured motion it holds, each a folder with an index of its drives."""

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from pydantic import BaseModel

from pipeline.base import store


class Index(BaseModel):
    """The index."""

    kinds: list[Literal["visual", "lidar"]]


def write(folder: Path, kinds: Iterable[str]) -> None:
    """Write ``index.json``, once each kind's folder is complete."""
    store.write_json(folder / "index.json", {"schema": store.SCHEMA, "kinds": sorted(kinds)})


def read(folder: Path) -> dict[str, Path]:
    """Return kind → its folder. Raises InputError if there is no index, or a drive of one has no file."""
    kinds = store.read_json(folder / "index.json", stage="motion", form=Index)["kinds"]
    for kind in kinds:
        store.read_index(folder / kind, stage="motion")
    return {kind: folder / kind for kind in kinds}
