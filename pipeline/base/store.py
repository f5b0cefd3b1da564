"""Read and write the HDF5 files and indexes that stages exchange.

One file per drive. Root attributes: ``schema`` (int), ``drive``, ``stage``, ``params`` (JSON), and what the stage adds;
every dataset has an attribute ``unit``. ``frame`` int32 [F] holds KITTI frame numbers, ``time_s`` float64 [F] seconds
since the drive's first oxts row. Ragged data: ``ptr`` int64 [F+1] and concatenated rows; frame i owns
``rows[ptr[i]:ptr[i+1]]``. The attribute ``pointer`` of the rows names the pointers. If the rows are numbers of other
rows, counted from 0 in each frame, the attribute ``refers_to`` names those.

``params`` holds the settings of the chain that made the file: a stage adds its own section to its input's,
``params=source.params | {"clouds": settings.model_dump(mode="json")}``.

Files are deterministic: written once, in a fixed order, with no clock, host or user inside. They have a temporary name
until they are complete. HDF5 does not check contents, so readers do.
"""

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import h5py
import hdf5plugin
import numpy as np
from pydantic import BaseModel, ValidationError

from pipeline.base.atomic import Sink, replacing
from pipeline.base.errors import InputError, error_context
from pipeline.base.files import MiB, read_bytes
from pipeline.base.params import SPLITS

SCHEMA = 3  # 2: pointers were known by name; 1: gzip
_MOST_JSON_BYTES = 256 * MiB
# What h5py raises for damaged bytes.
_H5PY_ERRORS = (OSError, RuntimeError, LookupError, ValueError, TypeError, ArithmeticError, AttributeError, MemoryError)
_CHUNK_ROWS = 32768  # of ragged data
_CHECKED_ROWS = 1024  # of uncompressed data, under one checksum
# A checksum, as Blosc2 does not detect a changed bit. Sizes and speeds of the alternatives: docs/log.md.
_POINTS = {**hdf5plugin.Blosc2(cname="lz4", filters=hdf5plugin.Blosc2.BITSHUFFLE), "fletcher32": True}
_PIXELS = {**hdf5plugin.Blosc2(cname="zstd", clevel=1, filters=hdf5plugin.Blosc2.SHUFFLE), "fletcher32": True}
_CACHE_BYTES = 1 << 20  # of chunks, for each dataset of an open file
PER_DRIVE = {"K": (3, 3), "T_cam_velo": (4, 4)}  # datasets without a row for each frame


class DriveWriter:
    """Write one drive's file; a context manager. The file appears under its name when the block ends without error."""

    def __init__(self, path: Path, *, stage: str, drive: str, params: Mapping[str, Any]) -> None:
        """`params`: JSON-able content of the params sections that determine the file."""
        self.path = path
        self.attrs: dict[str, Any] = {
            "schema": SCHEMA,
            "stage": stage,
            "drive": drive,
            "params": json.dumps(params, sort_keys=True),
        }
        # Open until the end: HDF5 writes chunks when a dataset is closed, and bytes would depend on when that is.
        self._datasets: dict[str, h5py.Dataset] = {}

    def _create(self, name: str, unit: str, **options: Any) -> None:
        self._datasets[name] = self._file.create_dataset(name, **options)
        self._datasets[name].attrs["unit"] = unit

    def put(self, name: str, array: np.ndarray, unit: str = "") -> None:
        """Write a complete dataset, a row per frame. Arrays of three or more axes are compressed frame by frame."""
        array = np.asarray(array)
        options: dict[str, Any] = {}
        if array.ndim >= 3 and array.size:
            options = {"chunks": (1, *array.shape[1:]), **_PIXELS}
        elif array.ndim and array.size:
            options = {"chunks": (min(len(array), _CHECKED_ROWS), *array.shape[1:]), "fletcher32": True}
        self._create(name, unit, data=array, **options)
        self._sink.check()

    def put_pointers(self, name: str, counts: Iterable[int], unit: str = "") -> None:
        """Write the first row of each frame, and the end, int64 [F+1], for `counts` [F] of rows per frame."""
        ends = np.cumsum(np.fromiter(counts, np.int64))
        self.put(name, np.concatenate([[0], ends]).astype(np.int64), unit)

    def append(self, name: str, rows: np.ndarray, unit: str = "", pointer: str = "", refers_to: str = "") -> None:
        """Add `rows` [n, ...] at the end of dataset `name`; the first call creates it with their dtype and shape.

        `pointer`: the dataset with each frame's first row, see :meth:`put_pointers`; without it, a row per frame.
        `refers_to`: the dataset whose rows these numbers refer to.
        """
        rows = np.asarray(rows)
        if name not in self._datasets:
            # An image is one chunk, so that frames can be read one by one; points share chunks.
            length, encoding = (1, _PIXELS) if rows.ndim >= 3 else (_CHUNK_ROWS, _POINTS)
            self._create(
                name, unit, shape=(0, *rows.shape[1:]), maxshape=(None, *rows.shape[1:]), dtype=rows.dtype,
                chunks=(length, *rows.shape[1:]), **encoding,
            )  # fmt: skip
            for key, value in {"pointer": pointer, "refers_to": refers_to}.items():
                if value:
                    self._datasets[name].attrs[key] = np.bytes_(value.encode())  # fixed length, see _open
        dataset = self._datasets[name]
        start = len(dataset)
        dataset.resize(start + len(rows), axis=0)
        dataset[start:] = rows
        self._sink.check()

    def blank(self, name: str, shape: tuple[int, ...], dtype: type, unit: str = "", value: int = 0) -> None:
        """Create a dataset [F, ...] of `value`, for :meth:`fill`. Frames that are never filled take no space."""
        self._create(
            name, unit, shape=shape, maxshape=(None, *shape[1:]), dtype=dtype, fillvalue=value,
            chunks=(1, *shape[1:]), **_PIXELS,
        )  # fmt: skip

    def fill(self, name: str, index: int, array: np.ndarray) -> None:
        """Write one frame of a dataset created by :meth:`blank`."""
        self._datasets[name][index] = array
        self._sink.check()

    @contextmanager
    def _open(self) -> Iterator[None]:
        with (
            replacing(self.path) as tmp,
            Sink(tmp, self.path) as self._sink,
            self._sink.raising(),
            h5py.File(self._sink, "w", libver="v110") as self._file,
        ):
            yield
            for name, value in self.attrs.items():
                # Fixed length: variable-length text is in a heap without checksums, where a flipped bit hangs HDF5.
                self._file.attrs[name] = np.bytes_(value.encode()) if isinstance(value, str) else value

    def __enter__(self) -> Self:
        self._context = self._open()
        self._context.__enter__()
        return self

    def __exit__(self, *error: Any) -> bool | None:
        return self._context.__exit__(*error)


class DriveReader:
    """Read one drive's file; a context manager.

    `stage` None: of any stage. Raises InputError if the file is missing, is not an HDF5 file, was written by another
    stage or schema, or belongs to another drive; and when a dataset is damaged or has unexpected contents
    (see :meth:`_validate`).
    """

    def __init__(self, path: Path, *, stage: str | None) -> None:
        self.path, self._stage = path, stage or _stage_of(path)
        if not path.is_file():
            raise _missing(path, self._stage)
        self._datasets: dict[str, h5py.Dataset] = {}  # looking one up takes longer than reading a small one
        with self._read_errors():
            self._file = h5py.File(path, "r", rdcc_nbytes=_CACHE_BYTES)
        try:
            self._read_attributes(stage)
        except BaseException:
            self._file.close()
            raise

    def _read_attributes(self, expected: str | None) -> None:
        with self._read_errors():
            self.attrs: dict[str, Any] = {
                name: value.decode() if isinstance(value, bytes) else value for name, value in self._file.attrs.items()
            }
        self.drive, stage, schema = (str(self.attrs.get(name)) for name in ("drive", "stage", "schema"))
        if (stage, schema) != (expected or stage, str(SCHEMA)):
            problem = f"expected stage {self._stage!r}, schema {SCHEMA}; got stage {stage!r}, schema {schema}"
            raise InputError(problem, self.path, _other_version(self._stage))
        self._stage = stage
        if "_drive_" in self.path.stem and self.drive != self.path.stem:
            raise InputError(f"contains drive {self.drive}", self.path, fix_hint(self.path, self._stage))

    @contextmanager
    def _read_errors(self, name: str | None = None) -> Iterator[None]:
        """Re-raise errors of h5py and of validation as an InputError that names the file and the dataset."""
        try:
            yield
        except _H5PY_ERRORS as error:
            if isinstance(error, OSError) and error.errno:  # the system's, for instance no permission
                raise OSError(error.errno, os.strerror(error.errno), str(self.path)) from error
            where = f" in dataset {name!r}" if name else ""
            raise InputError(f"damaged{where} ({error})", self.path, fix_hint(self.path, self._stage)) from error

    @cached_property
    def params(self) -> dict[str, Any]:
        """Settings that determined the file: section of params.yaml → its content."""
        with self._read_errors():
            return dict(json.loads(self.attrs["params"]))

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
            frames = f"Frames: {self.frame[0]} to {self.frame[-1]}" if len(self.frame) else "It has none"
            raise InputError(f"has no frame {number}", self.path, frames)
        return int(rows[0])

    @cached_property
    def names(self) -> list[str]:
        """Names of the datasets."""
        with self._read_errors():
            return list(self._file)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a complete dataset."""
        return self._read(name, ())

    def rows(self, name: str, start: int, stop: int) -> np.ndarray:
        """Return ``dataset[start:stop]`` without reading the rest."""
        return self._read(name, slice(start, stop))

    def row(self, name: str, index: int) -> np.ndarray:
        """Return ``dataset[index]`` without reading the rest."""
        return self._read(name, index)

    def rows_of(self, name: str, frame_row: int) -> np.ndarray:
        """Return one frame's rows of a ragged dataset. `frame_row`: the frame's row in ``frame``."""
        self.dataset(name)  # raises if the file does not declare its pointers
        start, stop = self.rows(self.pointers[name], frame_row, frame_row + 2)
        return self.rows(name, start, stop)

    def shape(self, name: str) -> tuple[int, ...]:
        return self.dataset(name).shape

    @cached_property
    def pointers(self) -> dict[str, str]:
        """Ragged dataset → dataset with the first row of each frame, as the file declares it."""
        return self._declared("pointer")

    @cached_property
    def refers_to(self) -> dict[str, str]:
        """Dataset of numbers of rows → dataset with those rows, as the file declares it."""
        return self._declared("refers_to")

    def _declared(self, attribute: str) -> dict[str, str]:
        with self._read_errors():
            declared = {name: self._file[name].attrs.get(attribute) for name in self.names}
            return {name: value.decode() for name, value in declared.items() if value is not None}

    def _read(self, name: str, rows: int | slice | tuple[()]) -> Any:
        dataset = self.dataset(name)
        with self._read_errors(name):
            values = dataset[rows]
            if values.dtype.kind == "f" and not np.isfinite(values).all():
                raise ValueError("expected finite numbers")
        return values

    def dataset(self, name: str) -> h5py.Dataset:
        """Return the h5py dataset. Raises InputError if it is missing or its shape is wrong."""
        if name not in self._datasets:
            if name not in self.names:
                raise InputError(f"no dataset {name!r} (it has {', '.join(self.names)})", self.path)
            with self._read_errors(name):
                dataset = self._file[name]
                if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "iuf" or not dataset.ndim:
                    raise ValueError(f"expected an array of numbers, got {dataset!r}")
                self._validate(name, dataset)
            self._datasets[name] = dataset
        return self._datasets[name]

    def _validate(self, name: str, dataset: h5py.Dataset) -> None:
        """Check the number of rows, that frames and times increase, and that pointers cover the rows they point to."""
        if name in PER_DRIVE:
            if dataset.shape != PER_DRIVE[name]:
                raise ValueError(f"expected shape {PER_DRIVE[name]}, got {dataset.shape}")
            return
        if name in ("frame", "time_s"):
            values = dataset[()]
            if values.ndim != 1 or (np.diff(values) <= 0).any() or (name == "frame" and (values < 0).any()):
                raise ValueError("expected increasing numbers, one for each frame")
        pointer = self.pointers.get(name)
        if pointer is None and "frame" in self.names:
            rows = len(self._file["frame"]) + (name in self.pointers.values())
            if len(dataset) != rows:
                raise ValueError(f"expected {rows} rows, got {len(dataset)}, and no attribute pointer")
        elif pointer is not None:
            if pointer in self.pointers:
                raise ValueError(f"its pointers {pointer} declare pointers")
            ptr = self.dataset(pointer)[()]
            if ptr[0] != 0 or (np.diff(ptr) < 0).any() or ptr[-1] != len(dataset):
                raise ValueError(f"its {len(dataset)} rows do not fit {pointer}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _stage_of(path: Path) -> str:
    """Return the stage that a file below a folder data/ belongs to, for messages; elsewhere a placeholder."""
    folders = path.absolute().parts[:-1]
    return folders[folders.index("data") + 1] if "data" in folders[:-1] else "STAGE"


def fix_hint(path: Path, stage: str) -> str:
    """Return how to replace a damaged file."""
    return f"Delete it and fetch it: dvc pull {path}. Or make it again: dvc repro --force --single-item {stage}"


def _missing(path: Path, stage: str) -> InputError:
    fix = f"Make it: dvc repro {stage}. Or fetch it from another machine: dvc pull {stage}"
    return InputError("file is missing", path, fix)


def _other_version(stage: str) -> str:
    return f"Make it with this code: dvc repro {stage}. Or fetch what this code made: git pull, dvc pull {stage}"


def write_json(path: Path, content: Any, *, sort_keys: bool = True) -> None:
    """Write JSON in one step, so that no reader gets half a file."""
    with replacing(path) as tmp:
        tmp.write_text(json.dumps(content, indent=1, sort_keys=sort_keys, allow_nan=False) + "\n", encoding="utf-8")


def read_json(path: Path, *, stage: str, form: type[BaseModel] | None = None) -> dict[str, Any]:
    """Read a JSON object written by `stage`. Raises InputError if it is missing, invalid, or does not match `form`."""
    if not path.is_file():
        raise _missing(path, stage)
    with error_context(path, fix_hint(path, stage)):
        try:
            content = json.loads(read_bytes(path, _MOST_JSON_BYTES).decode())
            if not isinstance(content, dict):
                raise ValueError("expected an object")
        except (ValueError, RecursionError) as error:
            raise ValueError(f"invalid JSON ({error})") from error
        try:
            if form:
                form.model_validate(content)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(map(str, first["loc"]))
            raise ValueError(f"incomplete, or of another version: {key}: {first['msg']}") from error
    return content


def write_index(folder: Path, splits: Mapping[str, str]) -> None:
    """Write ``index.json``: drive → split (train, val or test) for each drive that has a file in `folder`, in order."""
    write_json(folder / "index.json", {"drives": dict(splits), "schema": SCHEMA}, sort_keys=False)


def read_index(folder: Path, *, stage: str) -> dict[str, str]:
    """Return drive → split of a stage's folder, in its order. Raises InputError if a drive in it has no file."""
    path = folder / "index.json"
    index = read_json(path, stage=stage)
    if index.get("schema") != SCHEMA:
        raise InputError(f"expected schema {SCHEMA}, got {index.get('schema')}", path, _other_version(stage))
    drives = index.get("drives")
    if not isinstance(drives, dict) or not all(_is_drive(name) and split in SPLITS for name, split in drives.items()):
        raise InputError(f"expected drives with a split of {', '.join(SPLITS)}", path, fix_hint(path, stage))
    missing = [drive for drive in drives if not (folder / f"{drive}.h5").is_file()]
    if missing:
        raise InputError(f"no file for {', '.join(missing)} of index.json", folder, f"Fetch them: dvc pull {stage}")
    return drives


def indexed(folder: Path) -> list[str]:
    """Return the drives in the folder's index.json, of any schema; none if it is missing or damaged."""
    try:
        drives = json.loads(read_bytes(folder / "index.json", _MOST_JSON_BYTES).decode())["drives"]
        return [drive for drive in drives if _is_drive(drive)]
    except (InputError, OSError, ValueError, KeyError, TypeError, RecursionError):
        return []


def _is_drive(name: str) -> bool:
    """Return whether a file of this name is directly in the index's folder."""
    return Path(name).name == name


def drives_in(splits: Mapping[str, str], *names: str) -> list[str]:
    """Return the drives with one of the splits `names`, in the index's order."""
    return [drive for drive, split in splits.items() if split in names]
