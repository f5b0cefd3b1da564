"""HDF5 files whose checksums are right, and what they say is not."""

import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from benchmarks.stress.mutated import Tried
from benchmarks.stress.readers import NAMED, Read, check_frames, check_graphs, everything, graphs
from benchmarks.stress.trial import Outcome, outcomes

Change = Callable[[h5py.File], object]


def tries(sound: Path, scratch: Path, trials: int, seed: int) -> Iterator[Tried]:
    """Yield each stage's file, and what does its trials; numbers in it are drawn `trials` times."""
    for kind, read in HDF5.items():
        yield f"{kind}.h5, made by hand", partial(_changed, sound, scratch, kind, read)
        yield f"{kind}.h5, numbers changed", partial(_redrawn, sound, scratch, kind, read, trials, seed)


HDF5: dict[str, Read] = {
    **{stage: everything(stage) for stage in ("ingest", "labels", "perception", "motion", "clouds")},
    "knn": graphs,
    "sets": graphs,
    "pictures": graphs,
}


def _put(name: str, array: Any, **options: Any) -> Change:
    """Return a change of a dataset into `array`; nothing if the file has none of this name."""

    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
            file.create_dataset(name, data=array, **options)

    return change


def _edit(name: str, edit: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Return a change of a dataset's numbers into `edit` of them."""

    def change(file: h5py.File) -> None:
        values = edit(file[name][()])
        del file[name]
        file.create_dataset(name, data=values)

    return change


def _link(name: str, target: Any) -> Change:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = target

    return change


def _absurd(name: str, shape: tuple[int, ...], chunks: tuple[int, ...] | None = None) -> Change:
    def change(file: h5py.File) -> None:
        dtype = file[name].dtype
        del file[name]
        file.create_dataset(name, shape=shape, chunks=chunks, dtype=dtype)

    return change


def _fall(ptr: np.ndarray) -> np.ndarray:
    ptr[2], ptr[3] = ptr[3], ptr[2] - 1
    return ptr


CHANGES: dict[str, Change] = {
    "another drive": lambda file: file.attrs.update(drive="2026_01_03_drive_0002"),
    "no drive": lambda file: file.attrs.pop("drive"),
    "the drive is a number": lambda file: file.attrs.update(drive=3),
    "another stage": lambda file: file.attrs.update(stage="x"),
    "schema is an array": lambda file: file.attrs.update(schema=np.arange(3)),
    "frame twice": _edit("frame", lambda frame: np.maximum(frame, frame[1])),
    "frame reversed": _edit("frame", lambda frame: frame[::-1]),
    "frame below 0": _edit("frame", lambda frame: frame - 10),
    "frame as text": _put("frame", np.array(["1"] * 8, "S4")),
    "frame as fractions": _edit("frame", lambda frame: frame.astype(float)),
    "frames missing": _edit("frame", lambda frame: frame[:-1]),
    "NaN in times": _edit("time_s", lambda time_s: np.where(np.arange(len(time_s)) == 3, np.nan, time_s)),
    "times fall": _edit("time_s", lambda time_s: -time_s),
    "times of two columns": _edit("time_s", lambda time_s: np.stack([time_s, time_s], 1)),
    "an external link": _link("frame", h5py.ExternalLink("/dev/zero", "/frame")),
    "a soft link": _link("frame", h5py.SoftLink("/time_s")),
    "a group": lambda file: (file.pop("frame"), file.create_group("frame")),
    "object references": lambda file: _put("frame", np.array([file.ref] * 8, h5py.ref_dtype))(file),
    "absurd frame": _absurd("frame", (1 << 40,), (1 << 20,)),
    "absurd chunks": _absurd("time_s", (1 << 31,), (1 << 29,)),
    "nothing stored": _absurd("time_s", (1 << 36,)),
}
OF_KIND: dict[str, dict[str, Change]] = {
    "ingest": {
        "NaN in K": _edit("K", lambda K: K * np.nan),
        "K of another shape": _edit("K", lambda K: K[:2]),
        "lidar_ptr jumps back": _edit("lidar_ptr", _fall),
    },
    "labels": {"NaN in labels": _edit("steering_rad", lambda steering: steering * np.nan)},
    "clouds": {
        "ptr jumps back": _edit("ptr", _fall),
        "ptr beyond the end": _edit("ptr", lambda ptr: ptr * 2),
        "ptr of absurd numbers": _edit("ptr", lambda ptr: np.where(np.arange(len(ptr)) == 8, 1 << 62, ptr)),
        "absurd points": _absurd("xyz", (1 << 40, 3), (1 << 15, 3)),
        "wide points": _absurd("xyz", (100, 1 << 28), (1, 1 << 28)),
    },
    "knn": {
        "indices out of range": _edit("indices", lambda indices: indices + 60),
        "signed indices": _edit("indices", lambda indices: -indices.astype(np.int32)),
        "degrees of others": _edit("degree", lambda degree: degree + 1),
        "points of two columns": _edit("xyz", lambda xyz: xyz[:, :2]),
        "ptr starts at 1": _edit("ptr", lambda ptr: np.maximum(ptr, 1)),
    },
    "sets": {
        "centres out of range": _edit("centres_2", lambda centres: centres + 20),
        "neighbours out of range": _edit("neighbours_1", lambda neighbours: neighbours + 60),
    },
    "pictures": {"images as fractions": _edit("image", lambda image: image.astype(np.float32))},
}


def _changed(sound: Path, scratch: Path, kind: str, read: Read) -> Iterator[Outcome]:
    """Each hostile change of a file: none may be accepted."""
    changes = list((CHANGES | OF_KIND.get(kind, {})).items())
    path = scratch / NAMED

    def work(trial: int) -> bool:
        name, change = changes[trial]
        shutil.copyfile(sound / f"{kind}.h5", path)
        with h5py.File(path, "r+") as file:
            change(file)
        read(path)
        raise AssertionError(f"{name} was not noticed")

    yield from outcomes(work, range(len(changes)), path)


def _redrawn(sound: Path, scratch: Path, kind: str, read: Read, trials: int, seed: int) -> Iterator[Outcome]:
    """Numbers that are others, stored with the right checksum: refused, or nothing that could not be."""
    path = scratch / NAMED
    check = check_graphs if read is graphs else check_frames

    def work(trial: int) -> bool:
        rng = np.random.default_rng([seed, trial, *kind.encode()])
        shutil.copyfile(sound / f"{kind}.h5", path)
        with h5py.File(path, "r+") as file:
            dataset = file[str(rng.choice(sorted(file)))]
            values = dataset[()]
            at = rng.integers(values.size, size=int(rng.integers(1, 4)))
            bits = values.reshape(-1).view(f"u{values.dtype.itemsize}")
            bits[at] ^= bits.dtype.type(1) << rng.integers(8 * values.dtype.itemsize, size=len(at)).astype(bits.dtype)
            dataset[...] = values
        check(path, read(path))
        return False

    yield from outcomes(work, range(trials), path)
