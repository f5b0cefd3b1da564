"""Describe a file or folder of any stage as JSON-able values; lists of mappings are tables."""

import csv
from collections import Counter
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.base.files import size_of
from pipeline.base.params import SECTIONS
from pipeline.base.store import read_json
from pipeline.inspect import drive_file
from pipeline.inspect.diff import flatten
from pipeline.inspect.drive_file import read_errors

Content = dict[str, Any]
_STAGES = (*SECTIONS, "scores", "report")


def describe(path: Path) -> Content:
    """Return ``kind``, ``path``, ``bytes`` and what is specific to the kind.

    A file of a model, of the encoder or of results is described with its folder.

    Raises InputError if `path` is missing, damaged, or not an artefact.
    """
    if path.is_file() and path.suffix == ".h5":
        return drive_file.describe(path)
    folder = path.absolute().parent if path.is_file() else path
    content = _folder(folder) if folder.is_dir() else None
    if content is None:
        problem = "no artefact of a stage" if path.exists() else "no file or folder of this name"
        raise InputError(problem, path, "Pass data/, or a folder or an .h5 file in it; for raw drives: steer doctor")
    return {"kind": content.pop("kind"), "path": str(folder), "bytes": size_of(folder), **content}


def _folder(folder: Path) -> Content | None:
    if (folder / "index.json").is_file():
        index = read_json(folder / "index.json", stage=folder.name)
        if "kinds" not in index:  # motion/index.json lists folders
            return _drives(folder, index)
    if (folder / "config.json").is_file():
        return _network(folder)
    if (folder / "metrics.json").is_file():
        numbers = flatten(read_json(folder / "metrics.json", stage=folder.name))
        return {"kind": "metrics", **{key: value for key, value in numbers.items() if "[" not in key}}
    if pictures := sorted(folder.glob("????_??_??_drive_????.png")):
        return {"kind": "pictures", "drives": [{"drive": path.stem, "bytes": size_of(path)} for path in pictures]}
    return _parts(folder)


def _drives(folder: Path, index: Content) -> Content:
    """Describe a folder with one file per drive: split, frames and gaps of each drive."""
    splits = index.get("drives")
    if not isinstance(splits, dict) or not all(Path(drive).name == drive for drive in splits):
        raise InputError("expected drives with their splits", folder / "index.json", "Make it again: dvc repro")
    rows: list[Content] = []
    content: Content = {"kind": "folder of drives"}
    for drive, split in splits.items():
        path = folder / f"{drive}.h5"
        row = {"drive": drive, "split": split}
        if not path.is_file():
            rows.append(row | {"missing": "file is missing"})
            continue
        summary = drive_file.summary(path)
        content |= {"stage": summary["stage"], "params": summary["params"]}
        rows.append(row | {key: summary[key] for key in ("frames", "first", "last", "missing", "bytes")})
    return content | {"frames": sum(row.get("frames", 0) for row in rows), "drives": rows}


def _network(folder: Path) -> Content:
    """Describe a trained model or the encoder by its config.json and the last line of its curve.csv."""
    stage = "encoder" if (folder / "encoder.pt").is_file() else f"train@{folder.name}"
    config = read_json(folder / "config.json", stage=stage)
    splits = config.pop("splits", None) or {}
    drives = len(config.pop("frames_per_drive", ())) or dict(Counter(splits.values()))
    content: Content = {"kind": stage.partition("@")[0].replace("train", "model"), "drives": drives, **config}
    content["checkpoints"] = sorted(str(path.relative_to(folder)) for path in folder.rglob("*.pt"))
    curve = folder / "curve.csv"
    if curve.is_file():
        with read_errors(curve), curve.open(newline="", encoding="utf-8") as file:
            content["end_of_curve"] = [*csv.DictReader(file, strict=True)][-1]
    return content


def _parts(folder: Path) -> Content | None:
    """Describe data/, or one of its folders that holds several artefacts, as graphs/: one row each."""
    inside = folder.absolute().name in _STAGES
    rows: list[Content] = []
    for part in sorted(path for path in folder.iterdir() if inside or path.name in _STAGES):
        try:
            content = _folder(part) if part.is_dir() and not part.name.startswith(".") else None
        except InputError as error:
            content = {"kind": "damaged", "problem": str(error)}
        if content and content["kind"] == "folder of artefacts":
            rows += [row | {"folder": f"{part.name}/{row['folder']}"} for row in content["parts"]]
        elif content:
            drives = content.get("drives")
            counts = {"drives": len(drives), "frames": content.get("frames")} if isinstance(drives, list) else {}
            row = {"folder": part.name, "kind": content["kind"], **counts, "bytes": size_of(part)}
            rows.append(row | {key: content[key] for key in content if key == "problem"})
    return {"kind": "folder of artefacts", "parts": rows} if rows else None
