"""A drive's file from blocks of its frames, by any number of processes.

A block holds what a stage makes of some consecutive frames of a drive, as plain arrays in a file of its own: the unit
of work, and of what a kill can lose. Blocks are made in any order, :class:`BlockWriter`. Where frames have different
numbers of rows, nobody knows before all blocks are there which rows share a chunk of the drive's file. Then its chunks
are encoded in parts, again in any order, :func:`encode`, and joined as they are, :func:`join`. So neither where blocks
or parts end, nor who made them, shows in the file's bytes.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from pipeline.base.atomic import replacing
from pipeline.base.store import DriveReader, DriveWriter

_HEADER, _AFTER = "header of the block", "left by the block"  # names in the file, beside those of datasets
_FRAMES = "frames of "  # before a dataset's name: which frames of the block are filled
_PART = "part"  # in place of a stage's name


class Column(NamedTuple):
    """What a block holds of a dataset."""

    made_by: str  # the method of DriveWriter: put, put_once, put_pointers, append, blank
    unit: str
    dtype: str
    shape: list[int]  # of one row
    rows: int
    frames: int = 0  # of `blank`: how many may have a row
    value: int = 0  # of `blank`: where none is


class BlockWriter(DriveWriter):
    """What a :class:`DriveWriter` is to a drive, for some consecutive frames; at its end, `path` holds their block.

    Every block of a drive has the same datasets. Set `log` to what it is to tell of itself, JSON-able, and `after` to
    what the next block is to know; `before` is what the block before left so, None for the first.
    """

    def __init__(self, path: Path, *, stage: str, drive: str, params: Any) -> None:
        super().__init__(path, stage=stage, drive=drive, params=params)
        self.log: dict[str, Any] = {}
        self.before: bytes | None = None
        self.after: bytes = b""
        self._columns: dict[str, Column] = {}
        self._rows: dict[str, list[np.ndarray]] = {}
        self._filled: dict[str, list[int]] = {}

    def put(self, name: str, array: np.ndarray, unit: str = "") -> None:
        self._start("put", name, np.asarray(array), unit)

    def put_once(self, name: str, array: np.ndarray, unit: str = "") -> None:
        self._start("put_once", name, np.asarray(array), unit)

    def put_pointers(self, name: str, counts: Any, unit: str = "") -> None:
        self._start("put_pointers", name, np.fromiter(counts, np.int64), unit)

    def append(self, name: str, rows: np.ndarray, unit: str = "") -> None:
        if name not in self._columns:
            self._start("append", name, np.asarray(rows), unit)
        else:
            self._rows[name].append(np.array(rows))  # a copy: the caller may use its array again

    def blank(self, name: str, shape: tuple[int, ...], dtype: type, unit: str = "", value: int = 0) -> None:
        self._start("blank", name, np.empty((0, *shape[1:]), dtype), unit)
        self._columns[name] = self._columns[name]._replace(frames=shape[0], value=value)
        self._filled[name] = []

    def fill(self, name: str, index: int, array: np.ndarray) -> None:
        self._filled[name].append(index)
        self._rows[name].append(np.array(array)[None])

    def _start(self, made_by: str, name: str, rows: np.ndarray, unit: str) -> None:
        self._columns[name] = Column(made_by, unit, rows.dtype.str, [*rows.shape[1:]], 0)
        self._rows[name] = [rows.copy()]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        if error is not None:
            return
        arrays: dict[str, Any] = {}
        for name, column in self._columns.items():
            arrays[name] = np.concatenate(self._rows.pop(name), dtype=column.dtype, casting="unsafe")
            self._columns[name] = column._replace(rows=len(arrays[name]))
        arrays |= {_FRAMES + name: np.array(frames, np.int64) for name, frames in self._filled.items()}
        header = json.dumps({"attrs": self.attrs, "columns": self._columns, "log": self.log})
        with replacing(self.path) as tmp:
            arrays |= {_HEADER: np.array(header), _AFTER: np.frombuffer(self.after, np.uint8)}
            np.savez(tmp, **arrays)


@dataclass(frozen=True)
class Block:
    """A file of :class:`BlockWriter`."""

    path: Path
    attrs: dict[str, Any]
    columns: dict[str, Column]
    log: dict[str, Any]

    def rows(self, name: str) -> np.ndarray:
        """Return a dataset's rows; where frames may lack one, those of the frames that are filled."""
        with np.load(self.path) as file:
            rows: np.ndarray = file[name]
        return rows

    def left(self) -> bytes:
        """Return what it left for the next block."""
        return self.rows(_AFTER).tobytes()

    def filled(self, name: str) -> np.ndarray:
        """Return which frames of the block have a row in a dataset where they may lack one."""
        return self.rows(_FRAMES + name)


def read_block(path: Path) -> Block:
    """Read what a block says of itself, and no rows."""
    with np.load(path) as file:
        header = json.loads(str(file[_HEADER]))
    columns = {name: Column(*fields) for name, fields in header["columns"].items()}
    return Block(path, header["attrs"], columns, header["log"])


def encode(blocks: Sequence[Block], part: int, parts: int, path: Path) -> None:
    """Write part number `part` of `parts` of all chunks of a drive's datasets to `path`, encoded as its file has them.

    `blocks` are all of the drive, in order.
    """
    with DriveWriter(path, stage=_PART, drive=str(blocks[0].attrs["drive"]), params={}) as file:
        for name, column in blocks[0].columns.items():
            if column.made_by == "append":
                _make(file, name, column)
                start, stop = _share(_total(blocks, name), file.chunk_rows(name), part, parts)
                for rows in _between(blocks, name, start, stop):
                    file.append(name, rows)
            elif column.made_by == "blank":
                start, stop = _share(_total(blocks, name), 1, part, parts)
                _make(file, name, column, frames=stop - start)
                of_frames = (row for rows in _between(blocks, name, start, stop) for row in rows)
                for index, row in enumerate(of_frames):
                    file.fill(name, index, row)


def join(blocks: Sequence[Block], parts: Sequence[Path], file: DriveWriter) -> None:
    """Write a drive's file of its blocks, in order, and of all parts of :func:`encode`, in order."""
    file.attrs |= blocks[0].attrs
    for name, column in blocks[0].columns.items():
        match column.made_by:
            case "put":
                file.put(name, np.concatenate([block.rows(name) for block in blocks]), column.unit)
            case "put_pointers":
                file.put_pointers(name, np.concatenate([block.rows(name) for block in blocks]), column.unit)
            case "put_once":
                file.put_once(name, blocks[0].rows(name), column.unit)
            case "append":
                _make(file, name, column)
                total = _total(blocks, name)
                file.put_chunks(name, _open(parts), total, range(0, total, file.chunk_rows(name)))
            case "blank":
                *first, total = np.cumsum([0, *(block.columns[name].frames for block in blocks)]).tolist()
                _make(file, name, column, frames=total)
                filled = [start + block.filled(name) for start, block in zip(first, blocks, strict=True)]
                file.put_chunks(name, _open(parts), total, np.concatenate(filled).tolist())


def _make(file: DriveWriter, name: str, column: Column, frames: int = 0) -> None:
    """Make a dataset without rows, or one with so many frames that are to be filled."""
    if column.made_by == "append":
        file.append(name, np.empty((0, *column.shape), column.dtype), column.unit)
    else:
        file.blank(name, (frames, *column.shape), np.dtype(column.dtype).type, column.unit, column.value)


def _share(rows: int, chunk: int, part: int, parts: int) -> tuple[int, int]:
    """Return where a part of so many rows begins and ends, whole chunks of them."""
    chunks = -(-rows // chunk)
    start, stop = (min(rows, chunks * number // parts * chunk) for number in (part, part + 1))
    return start, stop


def _total(blocks: Sequence[Block], name: str) -> int:
    return sum(block.columns[name].rows for block in blocks)


def _between(blocks: Sequence[Block], name: str, start: int, stop: int) -> Iterator[np.ndarray]:
    """Yield the rows from `start` to `stop` of all blocks' rows, a block's at a time."""
    begin = 0
    for block in blocks:
        end = begin + block.columns[name].rows
        if max(start, begin) < min(stop, end):
            yield block.rows(name)[max(start - begin, 0) : stop - begin]
        begin = end


def _open(parts: Sequence[Path]) -> Iterator[DriveReader]:
    for path in parts:
        with DriveReader(path, stage=_PART) as part:
            yield part
