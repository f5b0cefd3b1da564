"""What the contents of a drive's file must be like before anybody computes with them.

HDF5 itself believes a file: it follows a link out of it, makes room for any shape, and says nothing of a pointer that
jumps back. The functions raise ValueError, whose text says what is wrong; :class:`pipeline.base.store.DriveReader`
adds the file and what to do.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np

_MOST_BYTES = 1 << 28  # of a chunk, and of the rows of one frame
_MOST_FRAMES = 1 << 24
_FILTERS = {h5py.h5z.FILTER_FLETCHER32, 32026}  # 32026: Blosc2; others' decoders may make any size of a few bytes
_OF_FRAMES = {"frame": "i", "time_s": "f"}  # kind of number
_OF_DRIVE = {"K": (3, 3), "T_cam_velo": (4, 4)}  # what has no row for each frame
_DRIVE = re.compile(r"[0-9]{4}_[0-9]{2}_[0-9]{2}_drive_[0-9]{4}")


def check_attributes(path: Path, drive: object) -> None:
    """Check that the file is of the drive that it is called after, if it is called after one."""
    if not isinstance(drive, str):
        raise ValueError("it does not say of which drive it is")
    if _DRIVE.fullmatch(path.stem) and drive != path.stem:
        raise ValueError(f"it is of drive {drive}, under the name of another")


def datasets(file: h5py.File) -> "Datasets":
    """Return the file's datasets by name, all of which lie in itself: another file's content is what that is today."""
    names = list(file)
    for name in names:
        if file.id.links.get_info(name.encode()).type != h5py.h5l.TYPE_HARD:
            raise ValueError(f"{name!r} is a link to elsewhere")
    return Datasets(file, names)


class Datasets(Mapping[str, h5py.Dataset]):
    """Name → dataset, opened once: to find one in a file takes longer than to read a small one."""

    def __init__(self, file: h5py.File, names: Sequence[str]) -> None:
        self._file, self._found = file, dict.fromkeys(names)

    def __getitem__(self, name: str) -> h5py.Dataset:
        if self._found[name] is None:
            self._found[name] = self._file[name]
        return self._found[name]

    def __contains__(self, name: object) -> bool:
        return name in self._found

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)


def check_form(name: str, file: Datasets) -> None:
    """Check type, storage and shape of a dataset before anything is read of it."""
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        raise ValueError("it is not a dataset")
    if dataset.dtype.kind not in "iuf" or not dataset.ndim:
        raise ValueError(f"it holds {dataset.dtype} of shape {dataset.shape}, and not rows of numbers")
    if dataset.external or dataset.is_virtual:
        raise ValueError("its numbers lie in another file")
    made = dataset.id.get_create_plist()
    if not {made.get_filter(index)[0] for index in range(made.get_nfilters())} <= _FILTERS:
        raise ValueError("it is encoded in another way than this project's files")
    row_bytes = int(np.prod([int(side) for side in dataset.shape[1:]], dtype=object)) * dataset.dtype.itemsize
    chunk_bytes = dataset.chunks[0] * row_bytes if dataset.chunks else 0
    whole = dataset.chunks is None or dataset.chunks[1:] == dataset.shape[1:]
    if not whole or max(row_bytes, chunk_bytes) > _MOST_BYTES:
        raise ValueError(f"its shape {dataset.shape} in chunks of {dataset.chunks} is none of this project's")
    if dataset.chunks is None and dataset.id.get_storage_size() != row_bytes * dataset.shape[0]:
        raise ValueError(f"its shape {dataset.shape} is not that of what is stored")
    _check_rows(name, dataset, file)


def _check_rows(name: str, dataset: h5py.Dataset, file: Datasets) -> None:
    """Check that it has a row for each frame; of pointers one more; those that pointers count are checked with them."""
    form = (dataset.ndim, dataset.dtype.kind)
    if name in _OF_FRAMES and (form != (1, _OF_FRAMES[name]) or len(dataset) > _MOST_FRAMES):
        raise ValueError(f"it holds {dataset.dtype} of shape {dataset.shape}, and not a number of each frame")
    if name == "frame" or "frame" not in file:
        return
    frames = file["frame"].shape
    if is_pointer(name):
        if dataset.dtype.kind != "i" or dataset.shape != (frames[0] + 1,):
            raise ValueError(f"it holds {dataset.dtype} of shape {dataset.shape} for {frames[0]} frames")
    elif name in _OF_DRIVE:
        if dataset.shape != _OF_DRIVE[name]:
            raise ValueError(f"it is of shape {dataset.shape}, and not {_OF_DRIVE[name]}")
    elif _pointer_of(name, file) is None and dataset.shape[0] != frames[0]:
        raise ValueError(f"it has {dataset.shape[0]} rows for {frames[0]} frames")


def check_values(name: str, values: np.ndarray) -> None:
    """Check numbers that were read: finite; frame numbers and times rise."""
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise ValueError("it holds numbers that are not finite")
    if name in ("frame", "time_s") and values.ndim and (values[1:] <= values[:-1]).any():
        raise ValueError("it does not rise from frame to frame")
    if name == "frame" and values.ndim and len(values) and values[0] < 0:
        raise ValueError("it has numbers below 0")


def check_pointers(name: str, ptr: np.ndarray, file: Datasets) -> None:
    """Check where each frame's rows begin [F+1]: from 0 to the end, never back, no frame of absurd size."""
    counts = np.diff(ptr)
    if ptr[0] != 0 or (counts < 0).any():
        raise ValueError("it does not count up from 0")
    for other in (other for other in file if _pointer_of(other, file) == name):
        rows = file[other]
        if ptr[-1] != rows.shape[0]:
            raise ValueError(f"it ends at {ptr[-1]}, and there are {rows.shape[0]} rows of {other}")
        largest = int(counts.max(initial=0))
        if largest * rows.dtype.itemsize * int(np.prod(rows.shape[1:], dtype=object)) > _MOST_BYTES:
            raise ValueError(f"a frame of {largest} rows of {other} is too large")


def is_pointer(name: str) -> bool:
    """Say whether a dataset of this name counts the rows of others."""
    return name == "ptr" or name.endswith("_ptr")


def _pointer_of(name: str, file: Datasets) -> str | None:
    """Return the dataset that says which rows of `name` are which frame's; None if each frame has one row."""
    own = f"{name.replace('neighbours', 'centres')}_ptr"
    if own in file:
        return own
    of_points = name in ("xyz", "cls", "degree") and file[name].ndim < 3  # classes may be images too
    return "ptr" if of_points and "ptr" in file else None
