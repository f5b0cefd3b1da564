"""What a file or folder is, of whichever stage, and what it holds: JSON-able."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.inspect import drive_file, raw_listing, trained
from pipeline.inspect.apart import apart
from pipeline.inspect.reading import json_object, mapping, size_of

Content = dict[str, Any]
# Files that are told with their folder.
_OF_A_FOLDER = (
    "index.json", "summary.json", "config.json", "metrics.json", "best.pt", "last.pt", "encoder.pt", "curve.csv",
    "predictions.csv", "structure.json", "neurons.json", "table.md", "table.csv", "index.html",
)  # fmt: skip


def describe(path: Path) -> Content:
    """Return what an artefact holds: ``kind``, ``path``, ``bytes`` and what is particular to its kind.

    ``made_of`` names the drives that it is made of, where it says so.

    Raises InputError if nothing is there, it is damaged, or nothing that a stage writes.
    """
    if not path.exists():
        raise InputError(f"{path} is missing: give a file or folder that a stage wrote, or a KITTI raw drive's folder")
    if path.is_file():
        if path.name in _OF_A_FOLDER:
            return describe(path.absolute().parent)
        if path.suffix not in (".h5", ".hdf5"):
            raise InputError(f"{path} is no artefact of a stage: give a drive's .h5 file, or a folder")
        return apart(drive_file.describe, path)
    if not path.is_dir():
        raise InputError(f"{path} is no plain file and no folder: give an artefact of a stage")
    for is_one, tell in _KINDS:
        if is_one(path):
            return {"path": str(path), "bytes": size_of(path), **tell(path)}
    raise InputError(f"{path} holds nothing that a stage writes, and no KITTI raw drive: give one of the files in it")


def _has(*names: str) -> Callable[[Path], bool]:
    return lambda folder: all((folder / name).is_file() for name in names)


def _drives(folder: Path) -> Content:
    """Tell a folder with an index of drives: of each its split, frames and bytes."""
    index = json_object(folder / "index.json")
    if "kinds" in index:  # stage motion: a folder for each way of measuring
        return _folders(folder)
    splits = index.get("drives")
    if not isinstance(splits, dict) or not all(Path(drive).name == drive for drive in splits):
        raise InputError(f"{folder / 'index.json'} is damaged: it has no drives with their splits. dvc repro makes it")
    drives, lacking, first = {}, [], None
    for drive, split in splits.items():
        path = folder / f"{drive}.h5"
        if not path.is_file():
            lacking.append(drive)
            continue
        told = apart(drive_file.summary, path)
        first = first or {"stage": told["stage"], "settings": told["settings"]}
        drives[drive] = {"split": str(split), "bytes": told["bytes"], **told["frames"]}
    count = sum(drive["count"] for drive in drives.values())
    return {
        "kind": "folder of drives",
        **(first or {}),
        "frames": count,
        "drives": drives,
        "lacking": lacking,
        "made_of": list(splits),
    }


def _folders(folder: Path) -> Content:
    """Tell a folder of artefacts, as data/clouds or data/: of each what it is, or what is wrong with it."""
    parts: Content = {}
    for part in _parts(folder):
        try:
            told = describe(part)
        except InputError as error:
            parts[part.name] = {"error": str(error)}
            continue
        inner = mapping(told.get("parts"))
        parts |= {f"{part.name}/{name}": one for name, one in inner.items()} or {part.name: _in_short(told)}
    return {"kind": "folder of artefacts", "parts": parts}


def _in_short(told: Content) -> Content:
    short = {key: told[key] for key in ("kind", "bytes", "frames", "parameters", "best_epoch") if key in told}
    return short | ({"drives": len(told["drives"])} if told["kind"].startswith("folder of") else {})


def _parts(folder: Path, levels: int = 2) -> list[Path]:
    """Return the folders in `folder` that are artefacts or hold some: data/ holds graphs/, and that variants."""
    hidden = (part for part in sorted(folder.iterdir()) if part.is_dir() and not part.name.startswith("."))
    of_a_stage = [is_one for is_one, _ in _KINDS[:-1]]
    return [
        part
        for part in hidden
        if any(is_one(part) for is_one in of_a_stage) or (levels > 1 and _parts(part, levels - 1))
    ]


def _drawn(folder: Path) -> list[str]:
    """Return the drives of which stage pictures drew something into a folder."""
    return sorted(path.stem for path in folder.glob("????_??_??_drive_????.png"))


def _is_model(folder: Path) -> bool:
    networks = (found for name in ("best.pt", "last.pt") for found in folder.rglob(name))
    return (folder / "config.json").is_file() and any(networks)


_KINDS: tuple[tuple[Callable[[Path], bool], Callable[[Path], Content]], ...] = (
    (raw_listing.is_drive, raw_listing.drive),
    (raw_listing.is_root, raw_listing.root),
    (_has("index.json"), _drives),
    (_is_model, trained.model),
    (_has("config.json"), trained.encoder),
    (_has("metrics.json", "predictions.csv"), trained.evaluation),
    (_has("metrics.json"), trained.figures),
    (lambda folder: bool(_drawn(folder)), lambda folder: {"kind": "pictures", "made_of": _drawn(folder)}),
    (lambda folder: bool(_parts(folder)), _folders),
)
