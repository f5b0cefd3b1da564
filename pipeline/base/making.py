"""How a drive is made: by one job, or of blocks of its frames, which become a file or a folder."""

import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.base import progress
from pipeline.base.atomic import replacing
from pipeline.base.blocks import Block, BlockWriter, encode, join, read_block
from pipeline.base.errors import InputError
from pipeline.base.jobs import Job, Steps, Summary
from pipeline.base.store import DriveWriter, read_json, write_json

Total = Callable[[Sequence[Summary]], Summary]
"""What the blocks of a drive say of themselves, in order → its summary."""


def whole(drive: str, path: Path) -> Steps:
    """Make a drive at `path` by one job, ``work(drive, path)``."""
    ((summary, seconds),) = yield [Job(drive, partial(_timed, drive, path))]
    return summary, seconds


def _timed(drive: str, path: Path, work: Callable[[str, Path], Summary]) -> tuple[Summary, float]:
    start = time.perf_counter()
    summary = work(drive, path)
    return summary, time.perf_counter() - start


class Blocks:
    """The blocks of a drive that ends up at `path`, some of which may be there from a run before."""

    def __init__(self, drive: str, path: Path, numbers: Sequence[int], size: int, suffix: str) -> None:
        """`numbers` are its frames' KITTI numbers, `size` how many a block has, `suffix` that of a block's file."""
        self.drive, self.path, self.numbers = drive, path, numbers
        count = len(numbers)
        self.spans = [range(start, min(start + size, count)) for start in range(0, count, size)] or [range(0)]
        self.paths = [folder(path) / f"{span.start}-{span.stop}{suffix}" for span in self.spans]
        self._missing = [number for number, block in enumerate(self.paths) if not block.exists()]

    @property
    def frames(self) -> int:
        """How many are in the blocks that are missing."""
        return sum(len(self.spans[number]) for number in self._missing)

    def jobs(self, write: Callable[[range, Path, Path | None, Any], None]) -> list[Job]:
        """Return the jobs that make the missing blocks: ``write(rows, path, path of the block before, work)``."""
        jobs = []
        for number in self._missing:
            rows = self.spans[number]
            numbers = self.numbers[rows.start : rows.stop]
            where = f"{self.drive}, frames {numbers[0]} to {numbers[-1]}" if numbers else self.drive
            before = self.paths[number - 1] if number else None
            call = partial(write, rows, self.paths[number], before)
            jobs.append(Job(where, partial(_blamed, self.drive, numbers, call)))
        return jobs


def folder(path: Path) -> Path:
    """Return where what a drive at `path` is made of waits."""
    return path.with_suffix(".blocks")


def file_of_blocks(blocks: Blocks, header: Mapping[str, Any], chained: bool, total: Total) -> Steps:
    """Make a drive's file of blocks, these by ``work(drive, rows, file)``, then the parts of the file, then the file.

    `header` is what a DriveWriter is told. `chained`: blocks are made one after the other, and each knows what the one
    before left it.
    """
    jobs = blocks.jobs(partial(_write_block, blocks.drive, header, chained))
    if chained:
        for job in jobs:
            yield [job]
    else:
        yield jobs
    made, count = [read_block(path) for path in blocks.paths], len(blocks.paths)
    parts = [folder(blocks.path) / f"{part}-of-{count}.h5" for part in range(count)]
    seconds = yield [
        Job(blocks.drive, partial(_write_part, made, part, count, path)) for part, path in enumerate(parts)
    ]
    start = time.perf_counter()
    with DriveWriter(blocks.path, **header) as file:
        join(made, parts, file)
    seconds += [time.perf_counter() - start, *(block.log["seconds"] for block in made)]
    return total([block.log["summary"] for block in made]), sum(seconds)


def _write_block(
    drive: str, header: Mapping[str, Any], chained: bool, rows: range, path: Path, before: Path | None,
    work: Callable[[str, range, BlockWriter], Summary],
) -> None:  # fmt: skip
    start = time.perf_counter()
    with BlockWriter(path, **header) as file:
        file.before = read_block(before).left() if chained and before else None
        summary = work(drive, rows, file)
        file.log = {"summary": summary, "seconds": time.perf_counter() - start}


def _write_part(blocks: Sequence[Block], part: int, parts: int, path: Path, _: object) -> float:
    start = time.perf_counter()
    encode(blocks, part, parts, path)
    return time.perf_counter() - start


_LOG = "block.json"  # in a block's folder


def folder_of_blocks(blocks: Blocks, total: Total) -> Steps:
    """Make a drive's folder of blocks, which are folders, by ``work(drive, rows, path)``: the files of all of them."""
    yield blocks.jobs(partial(_write_folder, blocks.drive))
    logs = [read_json(path / _LOG, stage="town") for path in blocks.paths]
    with replacing(blocks.path) as whole:
        for path in blocks.paths:
            shutil.copytree(path, whole, copy_function=_link, dirs_exist_ok=True, ignore=lambda *_: [_LOG])
    return total([log["summary"] for log in logs]), sum(log["seconds"] for log in logs)


def _write_folder(drive: str, rows: range, path: Path, _: object, work: Callable[[str, range, Path], Summary]) -> None:
    start = time.perf_counter()
    with replacing(path) as unfinished:
        summary = work(drive, rows, unfinished)
        write_json(unfinished / _LOG, {"summary": summary, "seconds": time.perf_counter() - start})


def _link(source: str, target: str) -> None:
    """Give a file a second name, or copy it where the file system cannot."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _blamed(drive: str, numbers: Sequence[int], call: Callable[[Any], None], work: Any) -> None:
    """Make a block of the frames `numbers`; an error says at which it happened."""
    progress.begin(None)
    try:
        call(work)
    except Exception as error:
        row = progress.row()
        if row is None or row >= len(numbers):  # it is not about a frame
            raise
        where = f"{drive}, frame {numbers[row]}"
        if isinstance(error, InputError):  # the line that users read
            raise type(error)(f"{where}: {error}") from error
        error.add_note(where)
        raise
