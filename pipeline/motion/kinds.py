"""The index of data/motion: which kinds of measured motion it holds, each a folder with an index of its drives."""

from collections.abc import Iterable
from pathlib import Path

from pipeline.base import store
from pipeline.base.errors import InputError


def write(folder: Path, kinds: Iterable[str]) -> None:
    """Write ``index.json``, once each kind's folder is complete."""
    store.write_json(folder / "index.json", {"schema": store.SCHEMA, "kinds": sorted(kinds)})


def read(folder: Path) -> dict[str, Path]:
    """Return kind → its folder. Raises InputError if there is no index, or a drive of one has no file."""
    kinds = store.read_json(folder / "index.json", stage="motion", keys=("kinds",))["kinds"]
    if not isinstance(kinds, list) or not set(map(str, kinds)) <= {"visual", "lidar"}:
        raise InputError(f"{folder / 'index.json'} names kinds of motion that there are not: dvc repro --force motion")
    for kind in kinds:
        store.read_index(folder / kind, stage="motion")
    return {kind: folder / kind for kind in kinds}
