"""The HDF5 files and indexes that stages exchange. With :mod:`pipeline.base.sound`, which
checks what is read, the only module that imports h5py.

One file per drive. Root attributes: ``schema`` (int), ``drive``, ``stage``, ``params`` (JSON of the sections that made
the file), and whatever the stage adds; every dataset has an attribute ``unit``. ``frame`` int32 [F] holds KITTI frame
numbers, ``time_s`` float64 [F] seconds since the drive's first oxts row. Ragged data: ``ptr`` int64 [F+1] and
concatenated rows, so that frame i owns ``rows[ptr[i]:ptr[i+1]]``.

Files are deterministic: written once, in a fixed order, with no clock, host or user inside, to a temporary name that
is changed when they are complete.
"""

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

import h5py
import hdf5plugin
import numpy as np
from pydantic import BaseModel, ValidationError

from pipeline.base import sound
from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError, error_context
from pipeline.base.files import MiB, check_file
from pipeline.base.params import SPLITS
from pipeline.base.sink import Sink

SCHEMA = 2  # 1: gzip
_MOST_JSON = 256 * MiB  # a metrics.json has some kB, a structure.json some MB
# What comes out of h5py for bytes that are not what they were.
_OF_H5PY = (RuntimeError, LookupError, ValueError, TypeError, ArithmeticError, AttributeError, MemoryError)
_NAMES = {list: "a list", type(None): "null"}
_CHUNK_ROWS = 32768  # of ragged data
_CHECKED_ROWS = 1024  # of what is not compressed, under one checksum
# A checksum, as Blosc2 takes a changed bit for good. Sizes and speeds of this and others: docs/files.md.
_ENCODED = {**hdf5plugin.Blosc2(cname="lz4", filters=hdf5plugin.Blosc2.BITSHUFFLE), "fletcher32": True}
_CACHE_BYTES = 1 << 20  # of chunks last read, for each dataset of a file that stays open
_MISSING = "{path} is missing. Make it: dvc repro {stage}. Bring it from another machine: dvc pull {stage}"
_OTHER = "Make it with this code: dvc repro {stage}. Or fetch what this code made: git pull, dvc pull {stage}"


class DriveWriter:
    """Write one drive's file; a context manager. The file appears under its name only when the block ends well."""

    def __init__(self, path: Path, *, stage: str, drive: str, params: Mapping[str, Any]) -> None:
        """`params` is the JSON-able content of the params sections that determine the file."""
        self.path = path
        self.attrs: dict[str, Any] = {
            "schema": SCHEMA,
            "stage": stage,
            "drive": drive,
            "params": json.dumps(params, sort_keys=True),
        }

    def put(self, name: str, array: np.ndarray, unit: str = "") -> None:
        """Write a complete dataset, a row per frame. Arrays of three or more axes are compressed frame by frame."""
        array = np.asarray(array)
        options: dict[str, Any] = {}
        if array.ndim >= 3 and array.size:
            options = {"chunks": (1, *array.shape[1:]), **_ENCODED}
        elif array.ndim and array.size:  # a checksum for all: a flipped bit of a label would teach something wrong
            options = {"chunks": (min(len(array), _CHECKED_ROWS), *array.shape[1:]), "fletcher32": True}
        self._file.create_dataset(name, data=array, **options).attrs["unit"] = unit
        self._sink.check()

    def put_once(self, name: str, array: np.ndarray, unit: str = "") -> None:
        """Write a complete dataset that is of the drive, not of its frames."""
        self.put(name, array, unit)

    def put_pointers(self, name: str, counts: Iterable[int], unit: str = "") -> None:
        """Write where the rows of each frame begin and end, int64 [F+1]; `counts` [F] says how many it has."""
        self.put(name, pointers(counts), unit)

    def append(self, name: str, rows: np.ndarray, unit: str = "") -> None:
        """Add `rows` [n, ...] at the end of dataset `name`, which the first call makes with their dtype and shape."""
        rows = np.asarray(rows)
        if name not in self._file:
            # An image is a chunk of its own, so that one frame can be read alone; points share chunks.
            chunk = (1 if rows.ndim >= 3 else _CHUNK_ROWS, *rows.shape[1:])
            dataset = self._file.create_dataset(
                name, shape=(0, *rows.shape[1:]), maxshape=(None, *rows.shape[1:]), dtype=rows.dtype,
                chunks=chunk, **_ENCODED,
            )  # fmt: skip
            dataset.attrs["unit"] = unit
        dataset = self._file[name]
        start = len(dataset)
        dataset.resize(start + len(rows), axis=0)
        dataset[start:] = rows
        self._sink.check()

    def blank(self, name: str, shape: tuple[int, ...], dtype: type, unit: str = "", value: int = 0) -> None:
        """Make a dataset [F, ...] full of `value`, for :meth:`fill`. Frames that are never filled take no space."""
        dataset = self._file.create_dataset(
            name, shape=shape, maxshape=(None, *shape[1:]), dtype=dtype, fillvalue=value,
            chunks=(1, *shape[1:]), **_ENCODED,
        )  # fmt: skip
        dataset.attrs["unit"] = unit

    def fill(self, name: str, index: int, array: np.ndarray) -> None:
        """Write one frame of a dataset made by :meth:`blank`."""
        self._file[name][index] = array
        self._sink.check()

    def chunk_rows(self, name: str) -> int:
        """Return how many rows of a dataset made by :meth:`append` or :meth:`blank` are stored together, as a chunk."""
        return int(self._file[name].chunks[0])

    def put_chunks(self, name: str, parts: Iterable["DriveReader"], rows: int, at: Iterable[int]) -> None:
        """Fill a dataset made by :meth:`append` or :meth:`blank` with chunks as they lie in other files, encoded.

        Args:
            parts: files whose datasets of this name were made in the same way.
            rows: that the dataset has in the end.
            at: the row at which each of their chunks begins, in their order.
        """
        dataset, chunk_at = self._file[name], iter(at)
        dataset.resize(rows, axis=0)
        for part in parts:
            source = part.dataset(name)
            for start in range(0, len(source), source.chunks[0]):
                rest = (0,) * (source.ndim - 1)
                mask, chunk = source.id.read_direct_chunk((start, *rest))
                dataset.id.write_direct_chunk((next(chunk_at), *rest), chunk, mask)
                self._sink.check()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._sink = stack.enter_context(Sink(stack.enter_context(replacing(self.path)), self.path))
            stack.enter_context(self._sink.to_blame())
            self._file = stack.enter_context(h5py.File(self._sink, "w", libver="v110"))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._stack.__exit__(kind, error, trace)
            return
        with self._stack:
            for name, value in self.attrs.items():
                # HDF5 keeps texts of any length in a heap without checksums, in which a flipped bit hangs it for good.
                self._file.attrs[name] = np.bytes_(value.encode()) if isinstance(value, str) else value


class DriveReader:
    """Read one drive's file; a context manager.

    Raises InputError if the file is missing, is not an HDF5 file, was written by another stage or schema, or is of
    another drive than its name says; and whenever what is read of it is not what a stage can have written, as
    :mod:`pipeline.base.sound` tells.
    """

    def __init__(self, path: Path, *, stage: str) -> None:
        if not path.is_file():
            raise InputError(_MISSING.format(path=path, stage=stage))
        self.path = path
        self._stage = stage
        self._checked: set[str] = set()
        with self._blamed():
            try:
                self._file = h5py.File(path, "r", rdcc_nbytes=_CACHE_BYTES)
            except OSError as error:
                if error.errno:  # the system's, as without permission; h5py leaves out the name
                    raise OSError(error.errno, os.strerror(error.errno), str(path)) from error
                raise
        try:
            self._check()
        except BaseException:
            self._file.close()
            raise

    def _check(self) -> None:
        with self._blamed():
            self.attrs: dict[str, Any] = {
                name: value.decode() if isinstance(value, bytes) else value for name, value in self._file.attrs.items()
            }
            writer, schema = self.attrs.get("stage"), self.attrs.get("schema")
            same = isinstance(writer, str) and np.shape(schema or 0) == () and (writer, schema) == (self._stage, SCHEMA)
        if not same:
            raise InputError(
                f"{self.path} has stage {writer!r}, schema {schema}; this code reads stage {self._stage!r}, schema "
                f"{SCHEMA}. " + _OTHER.format(stage=self._stage)
            )
        with self._blamed():
            self.drive = str(self.attrs.get("drive"))
            sound.check_attributes(self.path, self.attrs.get("drive"))
            self._datasets = sound.datasets(self._file)

    @contextmanager
    def _blamed(self, name: str | None = None) -> Iterator[None]:
        """Make of what goes wrong in reading a line that names the file, and its dataset `name`."""
        try:
            yield
        except OSError as error:
            if error.errno and error.filename:
                raise
            self._blame(error, name)
        except _OF_H5PY as error:
            self._blame(error, name)

    def _blame(self, error: Exception, name: str | None) -> NoReturn:
        where = f" in dataset {name!r}" if name else ""
        raise InputError(f"{self.path} is damaged{where} ({error}). {fix_hint(self.path, self._stage)}") from error

    @cached_property
    def params(self) -> dict[str, Any]:
        """What made the file: section of params.yaml → its content."""
        with self._blamed():
            sections: dict[str, Any] = json.loads(self.attrs["params"])
            if not isinstance(sections, dict):
                raise ValueError("its params are not the sections of a params file")
        return sections

    @cached_property
    def frame(self) -> np.ndarray:
        """KITTI frame numbers, int32 [F], ascending."""
        return self["frame"]

    @cached_property
    def time_s(self) -> np.ndarray:
        """Seconds since the drive's first oxts row, float64 [F]."""
        return self["time_s"]

    def row_of(self, number: int) -> int:
        """Return the row of the frame with this KITTI number. Raises InputError if the file has no such frame."""
        rows = np.flatnonzero(self.frame == number)
        if not len(rows):
            raise InputError(f"{self.path} has no frame {number}")
        return int(rows[0])

    @property
    def names(self) -> list[str]:
        """The datasets that it holds."""
        return list(self._datasets)

    def __contains__(self, name: str) -> bool:
        return name in self._datasets

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a whole dataset."""
        return self._read(name, ())

    def rows(self, name: str, start: int, stop: int) -> np.ndarray:
        """Return ``dataset[start:stop]`` without reading the rest."""
        return self._read(name, slice(start, stop))

    def row(self, name: str, index: int) -> np.ndarray:
        """Return ``dataset[index]`` without reading the rest."""
        return self._read(name, index)

    def shape(self, name: str) -> tuple[int, ...]:
        return self.dataset(name).shape

    def _read(self, name: str, rows: int | slice | tuple[()]) -> Any:
        dataset = self.dataset(name)
        with self._blamed(name):
            values = dataset[rows]
            sound.check_values(name, values)
            if isinstance(rows, tuple) and sound.is_pointer(name):
                sound.check_pointers(name, values, self._datasets)
        return values

    def dataset(self, name: str) -> h5py.Dataset:
        """Return the h5py dataset; raises InputError, naming the file, if it has none of that name."""
        if name not in self._checked:
            if name not in self._datasets:
                raise InputError(f"{self.path} has no dataset {name!r} (it has {', '.join(self._datasets)})")
            with self._blamed(name):
                sound.check_form(name, self._datasets)
            self._checked.add(name)
        return self._datasets[name]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def fix_hint(path: Path, stage: str) -> str:
    """Return how to get a whole file for one that is damaged."""
    fetch = f"Delete it and fetch it: dvc pull {path} (as damaged? docs/robustness.md, Sharing)"
    return f"{fetch}. Or make it again: dvc repro --force --single-item {stage}"


def write_json(path: Path, content: Any, *, sort_keys: bool = True) -> None:
    """Write JSON in one step: nobody ever reads a half-written file."""
    with replacing(path) as tmp:
        tmp.write_text(json.dumps(content, indent=1, sort_keys=sort_keys, allow_nan=False) + "\n", encoding="utf-8")


def read_json(path: Path, *, stage: str, form: type[BaseModel] | None = None) -> dict[str, Any]:
    """Read a JSON object written by `stage`. Raises InputError if it is missing, not valid, or not of a `form`."""
    if not path.is_file():
        raise InputError(_MISSING.format(path=path, stage=stage))
    hint = fix_hint(path, stage)
    with error_context(f"{path} is not valid JSON", fix=hint):
        check_file(path, _MOST_JSON)
        try:
            content = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refused)
        except RecursionError as error:
            raise ValueError("it is nested too deep") from error
    if not isinstance(content, dict):
        raise InputError(f"{path} holds {_NAMES.get(type(content), 'one value')}, and not names with values. {hint}")
    try:
        if form:
            form.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise InputError(f"{path} is incomplete, or of another version: {key}: {first['msg']}. {hint}") from error
    return content


def _refused(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a number of JSON")


def write_index(folder: Path, splits: Mapping[str, str]) -> None:
    """Write ``index.json``: drive name → its split (train, val or test), the drives that `folder` has a file for.

    Their order stays: a model's `roads` are the first ones.
    """
    write_json(folder / "index.json", {"drives": dict(splits), "schema": SCHEMA}, sort_keys=False)


def read_index(folder: Path, *, stage: str) -> dict[str, str]:
    """Return drive name → split of a stage's folder, in its order.

    Raises InputError if a drive that it names has no file.
    """
    index = read_json(folder / "index.json", stage=stage)
    if index.get("schema") != SCHEMA:
        raise InputError(
            f"{folder / 'index.json'} has schema {index.get('schema')}, this code reads {SCHEMA}. "
            + _OTHER.format(stage=stage)
        )
    drives = index.get("drives")
    if not isinstance(drives, dict) or not all(_is_drive(name) and split in SPLITS for name, split in drives.items()):
        raise InputError(
            f"{folder / 'index.json'} does not say of each drive whether it is of {', '.join(SPLITS)}. "
            + fix_hint(folder / "index.json", stage)
        )
    missing = [drive for drive in drives if not (folder / f"{drive}.h5").is_file()]
    if missing:
        raise InputError(f"{folder} lacks {', '.join(missing)}, named in its index.json. Get them: dvc pull {stage}")
    return drives


def indexed(folder: Path) -> list[str]:
    """Return the drives that the folder's index.json names, whatever its schema; none if there is no sound one."""
    try:
        drives = json.loads((folder / "index.json").read_text(encoding="utf-8"))["drives"]
        return [drive for drive in drives if _is_drive(drive)]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []


def _is_drive(name: str) -> bool:
    """Say whether a name of an index stays in its folder."""
    return Path(name).name == name


def of_split(splits: Mapping[str, str], *names: str) -> list[str]:
    """Return the drives whose split is one of `names`, in the index's order."""
    return [drive for drive, split in splits.items() if split in names]


def pointers(counts: Iterable[int]) -> np.ndarray:
    """Return ``ptr`` int64 [F+1] for rows of `counts` [F] per frame."""
    return np.concatenate([[0], np.cumsum(np.fromiter(counts, np.int64))]).astype(np.int64)
