"""Frames of a graph file as a network eats them: what kind they are, and runs of them as arrays.

Three kinds. `graph`: xyz float32 [N,3], cls uint8 [N], ptr int64 [B+1], degree uint8 [N], indices int64 [E].
`pointnet2`: xyz, cls, ptr, and for each level l from 1: centres_l int64 [M], neighbours_l int64 [M,n], centres_l_ptr
int64 [B+1]. `image`: uint8 [B,H,W,3]. Files number rows from 0 in each frame; arrays count on through all their frames.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store

Arrays = dict[str, np.ndarray]


def contents(path: Path) -> dict[str, Any]:
    """Return what kind of frames a graph file holds, as `steering_net.build` asks: kind, levels or image_size."""
    with store.DriveReader(path, stage="graphs") as file:
        if "image" in file:
            height, width = file.shape("image")[1:3]
            return {"kind": "image", "image_size": (height, width)}
        if "degree" in file:
            return {"kind": "graph"}
        return {"kind": "pointnet2", "levels": _levels(file)}


class Reader:
    """Reads runs of frames of an open graph file. What tells where frames begin is read once."""

    def __init__(self, file: store.DriveReader) -> None:
        self._file = file
        if "image" in file:
            self._names, self._ptr = ["image"], {"image": np.arange(len(file.frame) + 1)}
            return
        ptr = file["ptr"]
        self._names = ["xyz", "cls"]
        self._ptr = {"xyz": ptr, "cls": ptr}
        if "degree" in file:
            self._names += ["degree", "indices"]
            self._ptr |= {"degree": ptr, "indices": file["indices_ptr"]}
        else:
            for level in range(1, _levels(file) + 1):
                centres, neighbours = f"centres_{level}", f"neighbours_{level}"
                self._names += [centres, neighbours]
                self._ptr |= dict.fromkeys((centres, neighbours), file[f"{centres}_ptr"])

    def read(self, start: int, stop: int) -> Arrays:
        """Return the arrays of frames [start, stop)."""
        arrays = {}
        for name in self._names:
            ptr = self._ptr[name][start : stop + 1]
            rows = self._file.rows(name, ptr[0], ptr[-1])
            if (numbered := _numbered(name)) is not None:
                first = self._ptr[numbered][start:stop]  # of the rows that are numbered, each frame's first
                shift = np.repeat(first - first[0], np.diff(ptr))
                rows = rows.astype(np.int64) + shift.reshape(-1, *[1] * (rows.ndim - 1))
            arrays[name] = rows
            if name in _POINTERS or name.startswith("centres_"):
                arrays[_POINTERS.get(name, f"{name}_ptr")] = ptr - ptr[0]
        return arrays


def concatenate(parts: Sequence[Arrays]) -> Arrays:
    """Put runs of frames of one kind one after the other."""
    batch = {}
    for name in parts[0]:
        arrays = [part[name] for part in parts]
        numbered = _numbered(name)
        if numbered is not None:
            before = np.cumsum([0, *(len(part[numbered]) for part in parts)])
            arrays = [array + first for array, first in zip(arrays, before, strict=False)]
        if name.endswith("ptr"):
            arrays = [array[:-1] for array in arrays[:-1]] + arrays[-1:]
        batch[name] = np.concatenate(arrays)
    return batch


_POINTERS = {"xyz": "ptr"}  # the others are called as what they point into


def _numbered(name: str) -> str | None:
    """Return the array whose rows the numbers in array `name` count; None if it holds no such numbers."""
    if name in ("ptr", "indices"):
        return "xyz"
    if name.endswith("_ptr"):
        return name.removesuffix("_ptr")
    what, _, level = name.partition("_")
    if what in ("centres", "neighbours"):
        return "xyz" if level == "1" else f"centres_{int(level) - 1}"
    return None


def _levels(file: store.DriveReader) -> int:
    level = 0
    while f"centres_{level + 1}" in file:
        level += 1
    return level
