"""Read and write the HDF5 files and indexes that stages exchange.

A file of each stage's package describes their content, for instance pipeline/labels/label_file.py.
Files are deterministic: they are written once, in a fixed order, and contain no clock time, host or
user. A file may come from a stranger, so :func:`_check_datasets` accepts only plain arrays of
numbers. It may also be damaged: HDF5 checks its own structures, and Fletcher32 the values, so that
a wrong bit is an error.
"""

import errno
import io
import json
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Self

import h5py
import hdf5plugin
import numpy as np

from pipeline.base.errors import InputError

# Name of the file in a stage's folder that lists its drives.
INDEX = "index.json"
# Number of rows in a chunk of points, or of other short rows.
_CHUNK_ROWS = 32768
# Compression of points. docs/history.md compares sizes and speeds of alternatives. Blosc2 is not
# used, as its files can name a codec that runs code.
_POINTS = hdf5plugin.Blosc(cname="lz4", shuffle=hdf5plugin.Blosc.BITSHUFFLE)
# Compression of images.
_PIXELS = hdf5plugin.Blosc(cname="zstd", clevel=3, shuffle=hdf5plugin.Blosc.SHUFFLE)
# Types of a dataset with MIRROR_SIGNS.
COLUMN_TYPES = ("float32", "uint8")
# Attribute of a dataset [P,C] with C factors, 1 or -1, that give its rows in the mirror image.
MIRROR_SIGNS = "mirror_signs"
# Attribute of a dataset with a text that says what its numbers mean.
MEANING = "meaning"
# Largest size in bytes of a text in an attribute. HDF5 has no checksum of a larger attribute if
# there are many of them. The settings of a file have about 400 bytes.
_MAX_TEXT_BYTES = 4000
# Size in bytes of the cache of chunks that h5py has for each dataset of an open file.
_CACHE_BYTES = 1 << 20
# Numbers of the errors for a full disk: no space, an exhausted quota, and a file beyond a limit.
_FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
# Exceptions that h5py raises for damaged bytes.
_H5PY_ERRORS = (OSError, RuntimeError, LookupError, ValueError, TypeError)


class Column(NamedTuple):
    """Rows of a dataset, and its attributes."""

    rows: np.ndarray
    unit: str
    # Name of the dataset with the first row of each frame. It is empty if each frame has one row.
    pointer: str = ""
    # Factors of the C components of a row in the mirror image, 1 or -1. They are empty for datasets
    # whose mirror image the code knows.
    signs: tuple[int, ...] = ()
    # What the numbers mean. It is empty for datasets that the format of the file describes.
    meaning: str = ""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`, which replaces `path` if the block succeeds.

    The block creates a file or a folder there. A folder replaces only an empty folder. The unique
    temporary path is ``.NAME.????????.tmp/NAME``: its suffix still gives the format, and a glob for
    ``*.h5`` does not match it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # The path is in a temporary folder, as a file by mkstemp is unreadable for other users.
    prefix = f".{path.name}."
    with naming_full_disk(path), tempfile.TemporaryDirectory(".tmp", prefix, path.parent) as folder:
        tmp = Path(folder) / path.name
        yield tmp
        tmp.replace(path)


@contextmanager
def naming_full_disk(path: Path) -> Iterator[None]:
    """Add `path` to an exception of a full disk, which names no file, or a temporary one."""
    try:
        yield
    except OSError as error:
        if error.errno in _FULL_DISK:
            error.filename = str(path)
        raise


class Sink(io.FileIO):
    """The file below an HDF5 file. It records the first error and continues.

    HDF5 writes much of a file while closing it, where h5py drops errors: on a full disk, an
    incomplete file would look complete, and the process would crash at its end.
    """

    error: OSError | None = None

    def write(self, data: Any) -> int:
        unwritten = memoryview(data).cast("B")
        size = len(unwritten)
        try:
            # The system may write only a part at once.
            while unwritten:
                count = super().write(unwritten)
                unwritten = unwritten[count:]
        except OSError as error:
            self.error = self.error or error
        return size

    def truncate(self, size: int | None = None) -> int:
        try:
            super().truncate(size)
        except OSError as error:
            self.error = self.error or error
        return size or 0

    def check(self, path: Path) -> None:
        """Raise the recorded error, if there is one, with `path`, the file's final name."""
        if self.error:
            self.error.filename = str(path)
            raise self.error


class DriveWriter(ExitStack):
    """Write one drive's file. The file appears if the block of this context manager succeeds."""

    def __init__(
        self,
        path: Path,
        *,
        stage: str,
        version: int,
        drive: str,
        params: Mapping[str, Any],
        described: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        """Store what is written at the end: attributes, and `params` as one of them.

        `version` is that of the layout of the stage's files. `params` maps sections of params.yaml
        to their content, which is JSON-able. `described` maps datasets to attributes that describe
        them, beside unit, pointer and signs.
        """
        super().__init__()
        self.path = path
        self._described = dict(described or {})
        self.attrs: dict[str, Any] = {"schema": version, "stage": stage, "drive": drive}
        self.attrs["params"] = json.dumps(params, sort_keys=True)
        # Datasets stay open until the end. HDF5 writes chunks when a dataset is closed, so the
        # order of the bytes depends on when that is.
        self._datasets: dict[str, h5py.Dataset] = {}

    def put(self, name: str, array: np.ndarray, unit: str = "") -> None:
        """Write a complete dataset that has a row per frame."""
        # Only chunks have a checksum, and a chunk cannot be empty.
        chunks = array.shape if array.size else None
        self._create_dataset(name, array, {"unit": unit}, chunks=chunks, fletcher32=array.size > 0)

    def put_pointers(self, name: str, counts: Iterable[int], unit: str = "") -> None:
        """Write each frame's first row in a ragged dataset, then the number of rows: int64 [F+1].

        `counts` [F] has the number of rows of each frame.
        """
        self.put(name, np.cumsum([0, *counts], dtype=np.int64), unit)

    def append(
        self,
        name: str,
        rows: np.ndarray,
        unit: str = "",
        pointer: str = "",
        signs: tuple[int, ...] = (),
        meaning: str = "",
    ) -> None:
        """Add `rows` [n, ...] at the end of dataset `name`, which the first call creates.

        The arguments are those of a :class:`Column`; for its pointer, see :meth:`put_pointers`.
        """
        if name not in self._datasets:
            # An image is one chunk, so that frames can be read one by one; points share chunks.
            is_image = rows.ndim >= 3
            chunk_rows = 1 if is_image else _CHUNK_ROWS
            compression = _PIXELS if is_image else _POINTS
            shape = rows.shape[1:]
            options = {"maxshape": (None, *shape), "chunks": (chunk_rows, *shape), **compression}
            attributes: dict[str, Any] = {"unit": unit}
            if pointer:
                attributes["pointer"] = pointer
            if signs:
                attributes[MIRROR_SIGNS] = np.array(signs, np.int8)
            if meaning:
                attributes[MEANING] = meaning
            self._create_dataset(name, rows[:0], attributes, fletcher32=True, **options)
        dataset = self._datasets[name]
        dataset.resize(len(dataset) + len(rows), axis=0)
        dataset[len(dataset) - len(rows) :] = rows
        self._sink.check(self.path)

    def _create_dataset(
        self, name: str, array: np.ndarray, attributes: Mapping[str, Any], **options: Any
    ) -> None:
        """Create a dataset with `options` of h5py's create_dataset."""
        dataset = self._file.create_dataset(name, data=array, **options)
        _write_attributes(dataset, {**attributes, **self._described.get(name, {})})
        self._datasets[name] = dataset

    def __enter__(self) -> Self:
        unfinished = self.enter_context(replacing(self.path))
        self._sink = self.enter_context(Sink(unfinished, "w+"))
        self.callback(self._sink.check, self.path)  # after HDF5 has closed the file
        self._file = self.enter_context(h5py.File(self._sink, "w", libver="v110"))
        self.callback(_write_attributes, self._file, self.attrs)
        return super().__enter__()


class DriveReader(ExitStack):
    """Read one drive's file. The reader is a context manager.

    Raises InputError unless it is a valid file, by a stage and of a version that are read.
    """

    def __init__(self, path: Path, versions: Mapping[str, Sequence[int]]) -> None:
        """Open the file. `versions` is stage → versions of its files' layout that are read."""
        super().__init__()
        self.path = path
        self._stage = next(iter(versions)) if len(versions) == 1 else "STAGE"
        if not path.is_file():
            raise _file_fault("file is missing", path, self._stage)
        try:
            # No lock is needed, as files appear only when they are complete. Some disks have none.
            file = self.enter_context(h5py.File(path, "r", rdcc_nbytes=_CACHE_BYTES, locking=False))
            self.attrs = {name: _decode_text(value) for name, value in file.attrs.items()}
            self.datasets = _check_datasets(file)
            # Name of a dataset → its unit.
            self.units = _read_names(self.datasets, "unit")
            # Name of a dataset → what its numbers mean. Files of earlier revisions do not say it.
            self.meanings = _read_names(self.datasets, MEANING)
            # Name of a ragged dataset → name of the dataset with the first row of each frame.
            self.pointers = _read_names(self.datasets, "pointer")
            # Name of a dataset → factors of its components in the mirror image.
            self.signs = _read_signs(self.datasets)
        except _H5PY_ERRORS as error:
            raise _file_fault(f"damaged ({error})", path, self._stage) from error

        self._check_layout(versions)
        self.drive = str(self.attrs.get("drive"))
        if path.with_name(INDEX).is_file() and self.drive != path.stem:
            raise _file_fault(f"contains drive {self.drive}", path, self._stage)

        try:
            # Section of params.yaml → its content.
            self.params: dict[str, Any] = dict(json.loads(self.attrs["params"]))
        except (LookupError, ValueError, TypeError) as error:
            raise _file_fault(f"damaged in its settings ({error})", path, self._stage) from error
        # KITTI frame numbers, int32 [F], ascending.
        self.frame = self["frame"]
        # Seconds since the drive's first frame, float64 [F].
        self.time_s = self["time_s"]

    def _check_layout(self, versions: Mapping[str, Sequence[int]]) -> None:
        """Raise InputError unless a stage of `versions` wrote a layout that is read.

        Fixes then name the stage that wrote the file.
        """
        written_by = str(self.attrs.get("stage"))
        if written_by not in versions:
            problem = f"expected a file of stage {', '.join(versions)}; got stage {written_by}"
            raise _file_fault(problem, self.path, self._stage)
        self._stage = written_by
        schemas = [str(schema) for schema in versions[written_by]]
        schema = str(self.attrs.get("schema"))
        if schema not in schemas:
            problem = f"expected schema {' or '.join(schemas)}; got {schema}, of another revision"
            raise _file_fault(problem, self.path, self._stage)

    def row_of(self, number: int) -> int:
        """Return the row of the frame with this KITTI number.

        Raises InputError if the file has no such frame.
        """
        if number not in self.frame:
            frames = f"frames: {self.frame[:1]} to {self.frame[-1:]}"
            raise InputError(f"has no frame {number} ({frames})", self.path)
        return int(np.searchsorted(self.frame, number))

    def __contains__(self, name: str) -> bool:
        return name in self.datasets

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a complete dataset."""
        return self.row(name, ())

    def row(self, name: str, index: int | slice | tuple[()]) -> Any:
        """Return ``dataset[index]`` without reading all of it.

        Raises InputError if it is missing or damaged.
        """
        if name not in self.datasets:
            raise InputError(f"no dataset {name!r} (it has {', '.join(self.datasets)})", self.path)
        try:
            return self.datasets[name][index]
        except _H5PY_ERRORS as error:
            problem = f"damaged in dataset {name!r} ({error})"
            raise _file_fault(problem, self.path, self._stage) from error

    def rows_of(self, name: str, frame_row: int) -> np.ndarray:
        """Return one frame's rows of a ragged dataset; `frame_row` is its row in ``frame``."""
        start, stop = self.row(self.pointers[name], slice(frame_row, frame_row + 2))
        return self.row(name, slice(start, stop))


def _check_datasets(file: h5py.File) -> dict[str, h5py.Dataset]:
    """Return name → dataset of a file.

    Raises ValueError unless all datasets are arrays of numbers in the file itself. HDF5 would
    follow links, external storage and virtual datasets to other files, and would run the code of
    plugins for filters.
    """
    datasets = {}
    for name in file:
        if not isinstance(file.get(name, getlink=True), h5py.HardLink):
            raise ValueError(f"{name!r} is a link")
        dataset = file[name]
        if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "iuf":
            raise ValueError(f"{name!r}: expected an array of numbers")
        created = dataset.id.get_create_plist()
        is_elsewhere = dataset.is_virtual or created.get_external_count()
        filters = {created.get_filter(i)[0] for i in range(created.get_nfilters())}
        if is_elsewhere or filters - {hdf5plugin.Blosc.filter_id, h5py.h5z.FILTER_FLETCHER32}:
            problem = "has external storage or a filter other than Blosc and Fletcher32"
            raise ValueError(f"{name!r} {problem}")
        datasets[name] = dataset
    return datasets


def _write_attributes(target: h5py.File | h5py.Dataset, attributes: Mapping[str, Any]) -> None:
    """Write attributes. Texts get a fixed length, as HDF5 has no checksum of variable ones."""
    for name, value in attributes.items():
        if isinstance(value, str):
            text = value.encode()
            assert len(text) <= _MAX_TEXT_BYTES, f"{name} is too long for a checksum"
            value = np.array(text, h5py.string_dtype(length=max(1, len(text))))
        target.attrs[name] = value


def _read_names(datasets: Mapping[str, h5py.Dataset], attribute: str) -> dict[str, str]:
    """Return dataset → the text of its attribute, for the datasets that have the attribute."""
    return {
        name: str(_decode_text(dataset.attrs[attribute]))
        for name, dataset in datasets.items()
        if attribute in dataset.attrs
    }


def _read_signs(datasets: Mapping[str, h5py.Dataset]) -> dict[str, tuple[int, ...]]:
    """Return dataset → its MIRROR_SIGNS, for the datasets that have them.

    Raises ValueError unless each component has a factor of 1 or -1, and the dataset one of
    COLUMN_TYPES.
    """
    signs = {}
    for name, dataset in datasets.items():
        if MIRROR_SIGNS not in dataset.attrs:
            continue
        signs[name] = tuple(dataset.attrs[MIRROR_SIGNS].tolist())
        is_complete = dataset.shape[1:] == (len(signs[name]),)
        if not is_complete or {*signs[name]} - {1, -1} or dataset.dtype.name not in COLUMN_TYPES:
            types = " or ".join(COLUMN_TYPES)
            raise ValueError(f"{name!r}: expected {types} [P,C], and C signs of 1 or -1")
    return signs


def _decode_text(value: Any) -> Any:
    """Return an attribute's value. h5py reads a text as bytes if its length is fixed."""
    return value.decode() if isinstance(value, bytes) else value


def _file_fault(problem: str, path: Path, stage: str) -> InputError:
    """Return an exception about a file of a stage, with the commands that make or fetch it."""
    fix = f"Make it: dvc repro {stage}. Or fetch it: git pull, dvc pull {stage}"
    return InputError(problem, path, fix)


def write_json(path: Path, content: Any, *, sort_keys: bool = True) -> None:
    """Write JSON in one step, so that no reader gets half a file."""
    text = json.dumps(content, indent=1, sort_keys=sort_keys, allow_nan=False)
    write_text(path, f"{text}\n")


def write_text(path: Path, text: str) -> None:
    """Write a text in one step. A hard link to the earlier file, as in DVC's cache, stays as is."""
    with replacing(path) as tmp:
        tmp.write_text(text, encoding="utf-8")


def read_json(path: Path, *, stage: str) -> dict[str, Any]:
    """Read a JSON object written by `stage`. Raises InputError if it is missing or invalid."""
    if not path.is_file():
        raise _file_fault("file is missing", path, stage)
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError) as error:
        raise _file_fault(f"damaged ({error})", path, stage) from error


def write_index(folder: Path, drives: Mapping[str, str]) -> None:
    """Write the index of a stage's folder: drive → split, in this order."""
    write_json(folder / INDEX, {"drives": dict(drives)}, sort_keys=False)


def read_index(folder: Path, *, stage: str) -> dict[str, str]:
    """Return drive → split of a stage's folder, in the order of its index.

    Raises InputError if a drive in it has no file.
    """
    drives: dict[str, str] = read_json(folder / INDEX, stage=stage).get("drives", {})
    missing = [drive for drive in drives if not (folder / f"{drive}.h5").is_file()]
    if missing:
        raise _file_fault(f"no file for {', '.join(missing)} of index.json", folder, stage)
    return drives


def drives_in(splits: Mapping[str, str], *names: str) -> list[str]:
    """Return the drives that belong to one of the splits `names`, in the order of `splits`."""
    return [drive for drive, split in splits.items() if split in names]
