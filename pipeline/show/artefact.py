"""Describe a file or folder of any stage as JSON-able values; lists of mappings are tables."""

import csv
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.base.files import size_of
from pipeline.base.store import DriveReader, read_json
from pipeline.settings.preset import Params

Content = dict[str, Any]
_STAGES = (*Params.model_fields, "scores", "report")
_HEADER = ("schema", "drive", "stage", "params")
_MAX_SPANS = 8


def describe(path: Path) -> Content:
    """Return ``kind``, ``path``, ``bytes`` and further facts that depend on the kind.

    A file of a model, of the encoder or of results is described with its folder.

    Raises InputError if `path` is missing, damaged, or not an artefact.
    """
    if path.is_file() and path.suffix == ".h5":
        return _drive_file(path)
    folder = path.absolute().parent if path.is_file() else path
    content = _folder(folder) if folder.is_dir() else None
    if content is None:
        problem = "not an artefact of a stage" if path.exists() else "no such file or folder"
        raise InputError(problem, path, "Pass data/, or a folder or an .h5 file in it")
    return {"kind": content.pop("kind"), "path": str(folder), "bytes": size_of(folder), **content}


def _drive_file(path: Path) -> Content:
    """Describe one drive's file with a table of its datasets, the largest first."""
    with open_drive(path) as file:
        datasets = {name: file.dataset(name) for name in file.names}
        rows = [
            {
                "dataset": name,
                "shape": list(dataset.shape),
                "dtype": str(dataset.dtype),
                "unit": str(dataset.attrs.get("unit", "")),
                "bytes": dataset.id.get_storage_size(),
            }
            for name, dataset in datasets.items()
        ]
        rows.sort(key=lambda row: row["bytes"], reverse=True)
        return {"kind": "drive file", "path": str(path), **_header(file), "datasets": rows}


def _header(file: DriveReader) -> Content:
    frames, times = file.frame.tolist(), file.time_s
    attributes = {key: value for key, value in sorted(file.attrs.items()) if key not in _HEADER}
    return {
        "stage": str(file.attrs["stage"]),
        "drive": file.drive,
        "bytes": file.path.stat().st_size,
        "frames": len(frames),
        "first": frames[0] if frames else None,
        "last": frames[-1] if frames else None,
        "missing": format_spans(gaps(frames, frames[0], frames[-1])) if frames else "",
        "duration_s": float(times[-1] - times[0]) if frames else 0.0,
        "attributes": {key: value.tolist() if hasattr(value, "tolist") else value for key, value in attributes.items()},
        "params": file.params,
    }


def _folder(folder: Path) -> Content | None:
    """Describe a folder of a stage; None if it is not one."""
    if (folder / "index.json").is_file():
        index = read_json(folder / "index.json", stage=folder.name)
        if "kinds" not in index:  # motion/index.json lists folders
            return _drives(folder, index)
    if (folder / "config.json").is_file():
        return _network(folder)
    if (folder / "metrics.json").is_file():
        numbers = flatten(read_json(folder / "metrics.json", stage=folder.name))
        return {"kind": "metrics", **{key: value for key, value in numbers.items() if "[" not in key}}
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
        with open_drive(path) as file:
            header = _header(file)
        content |= {"stage": header["stage"], "params": header["params"]}
        rows.append(row | {key: header[key] for key in ("frames", "first", "last", "missing", "bytes")})
    return content | {"frames": sum(row.get("frames", 0) for row in rows), "drives": rows}


def _network(folder: Path) -> Content:
    """Describe a trained model or the encoder by its config.json and the last line of its curve.csv."""
    is_encoder = (folder / "encoder.pt").is_file()
    config = read_json(folder / "config.json", stage="encoder" if is_encoder else f"train@{folder.name}")
    with damage_as_input_error(folder / "config.json"):
        splits = config.pop("splits", None) or {}
        drives = len(config.pop("frames_per_drive", ())) or dict(Counter(splits.values()))
    content: Content = {"kind": "encoder" if is_encoder else "model", "drives": drives, **config}
    content["checkpoints"] = sorted(str(path.relative_to(folder)) for path in folder.rglob("*.pt"))
    curve = folder / "curve.csv"
    if curve.is_file():
        with damage_as_input_error(curve), curve.open(newline="", encoding="utf-8") as lines:
            content["end_of_curve"] = [*csv.DictReader(lines, strict=True)][-1]
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


@contextmanager
def damage_as_input_error(path: Path, fix: str = "Make it again: dvc repro. Or fetch it: dvc pull") -> Iterator[None]:
    """Convert exceptions of libraries on a damaged file to InputError; errors of the operating system pass unchanged.

    HDF5 and YAML raise many kinds, from KeyError to RecursionError.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno:
            raise
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"file is damaged ({reason})", path, fix) from error


@contextmanager
def open_drive(path: Path) -> Iterator[DriveReader]:
    """Open a drive's file of any stage. Raises InputError if it is damaged, also for errors within the block."""
    with damage_as_input_error(path), DriveReader(path, stage=None) as file:
        yield file


def flatten(value: Any, key: str = "") -> Content:
    """Return dotted key → leaf of nested mappings and lists; a tensor is one leaf, as an array."""
    if hasattr(value, "detach"):  # a tensor; torch is not imported for JSON
        value = value.detach().cpu()
        return {key: (value.float() if str(value.dtype) == "torch.bfloat16" else value).numpy()}
    if isinstance(value, Mapping) and value:
        parts = {f"{key}.{name}" if key else str(name): inner for name, inner in value.items()}
    elif isinstance(value, list | tuple) and value:
        parts = {f"{key}[{number}]": inner for number, inner in enumerate(value)}
    else:
        return {key: value}
    return {name: leaf for part, inner in parts.items() for name, leaf in flatten(inner, part).items()}


def gaps(frames: Sequence[int], first: int, last: int) -> list[tuple[int, int]]:
    """Return (first, last) of each run missing from ascending `frames` between `first` and `last`, both included."""
    edges = [first - 1, *frames, last + 1]
    return [(start + 1, stop - 1) for start, stop in pairwise(edges) if stop > start + 1]


def format_spans(runs: Sequence[tuple[int, int]]) -> str:
    """Return runs of frame numbers as text: 3, 7-9."""
    texts = [str(first) if first == last else f"{first}-{last}" for first, last in runs[:_MAX_SPANS]]
    return ", ".join([*texts, f"… ({len(runs)} in total)"] if len(runs) > _MAX_SPANS else texts)
