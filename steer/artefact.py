"""Show one file of a stage: its attributes, datasets and settings, one of its frames, or its points
in 3D.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader, replacing
from pipeline.report import street_view

Content = dict[str, Any]


def describe(path: Path) -> Content:
    """Return a drive's file or a checkpoint as plain values. Raises InputError if it is missing,
    damaged or another.
    """
    if path.suffix == ".pt":
        from pipeline.base import checkpoint

        return {
            "bytes": path.stat().st_size if path.is_file() else 0,
            **_without_tensors(checkpoint.load(path)),
        }
    with _open(path) as file:
        frames, datasets = file.frame.tolist(), {}
        for name, data in file.datasets.items():
            rows = f"rows of a frame: {file.pointers[name]}" if name in file.pointers else ""
            shape, size = " × ".join(map(str, data.shape)), f"{data.id.get_storage_size()} bytes"
            datasets[name] = [
                *filter(None, (f"{data.dtype} {shape}", data.attrs.get("unit", ""), rows, size))
            ]
        return {
            "bytes": path.stat().st_size,
            **{
                name: np.asarray(file.attrs[name]).tolist()
                for name in sorted(file.attrs)
                if name != "params"
            },
            "frames": f"{len(frames)}, {frames[0]} to {frames[-1]}" if frames else "0",
            "datasets": datasets,
            "settings": file.params,
        }


def frame(path: Path, number: int, out: Path | None = None) -> Content:
    """Return a frame's numbers by dataset; draw it to `out`. Raises InputError if it is missing or
    has no picture.
    """
    with _open(path) as file:
        row = file.row_of(number)
        names = [name for name, data in file.datasets.items() if data.shape == file.frame.shape]
        numbers = {name: file.row(name, row).item() for name in sorted(names)}
        if out:
            view = street_view.read_view(number, file)
            if not view.images() and view.xyz is None:
                raise InputError(
                    f"frame {number} has neither an image nor points", path, "Leave out --out"
                )
            street_view.save(
                street_view.sheet(f"{Path(*path.parts[-3:])}, frame {number}", view), out
            )
        return numbers


def view(path: Path, out: Path) -> None:
    """Write a page with some frames of a file in 3D. Raises InputError if the file has no
    points.
    """
    from pipeline.report import plots

    with _open(path) as file:
        if "xyz" not in file or not len(file["xyz"]):
            raise InputError(
                "has no points", path, "Pass a file of point clouds, or of graphs of points"
            )
        figure = plots.in_space(street_view.read_some(file))
    with replacing(out) as new:
        new.write_text(
            plots.to_html(figure, "space", "min(95vh, 105vw)", alone=True), encoding="utf-8"
        )


def _open(path: Path) -> DriveReader:
    if path.is_dir() or path.suffix != ".h5":
        raise InputError(
            "expected a drive's file (.h5) or a checkpoint (.pt)",
            path,
            "Pass one from a folder in data/",
        )
    return DriveReader(path, stage=None)


def _without_tensors(content: Mapping[str, Any]) -> Content:
    plain = {
        name: _without_tensors(value) if isinstance(value, Mapping) else value
        for name, value in content.items()
    }
    plain |= {name: ranges([*value]) for name, value in plain.items() if name in ("drives", "val")}
    return {
        name: value for name, value in plain.items() if not hasattr(value, "detach") and value != {}
    }


def ranges(drives: Sequence[str]) -> list[str]:
    """Return names of drives, with DATE_drive_0001..0009 for consecutive ones, as in
    ``ingest.drives``.
    """
    found = list[list[str]]()
    for name in drives:
        before = found[-1][-1] if found else ""
        follows = name[-4:].isdecimal() and before == f"{name[:-4]}{int(name[-4:]) - 1:04d}"
        found = [*found[:-1], [*found[-1], name]] if follows else [*found, [name]]
    return [names[0] + f"..{names[-1][-4:]}" * (len(names) > 1) for names in found]
