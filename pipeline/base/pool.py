"""Run a function over drives, or over blocks of their frames: worker processes, progress, going on after a kill.

DVC deletes a stage's outputs before it runs the stage, so finished drives and blocks wait in ``data/.resume/<stage>/``
under a key that hashes all that determines their drive; drives are moved into the stage's folder when all are done.
"""

import json
import shutil
import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from tqdm import tqdm

from pipeline.base import progress
from pipeline.base.atomic import replacing, sweep
from pipeline.base.blocks import Block, BlockWriter, encode, join, read_block
from pipeline.base.console import default_workers
from pipeline.base.errors import InputError
from pipeline.base.lock import held
from pipeline.base.processes import processes, with_work
from pipeline.base.resume import resume_key
from pipeline.base.store import DriveWriter, indexed, write_json

REFRESH_S = 0.5  # of the bar, while workers count
BLOCK_FRAMES = 32  # of a block; changes no byte of a file
J = TypeVar("J")
Summary = dict[str, Any]
Work = Callable[[str, Path], Summary]
"""``work(drive, path)`` writes the drive's file or folder to `path` in one step and returns what the log says."""
FrameWork = Callable[[str, range, DriveWriter], Summary]
"""``work(drive, rows, file)`` writes the `rows` of :func:`run_over_frames`' frames to `file`; returns their counts."""
_BROKEN = (
    "a worker process died (out of memory?) at or near {where}: use fewer workers (STEER_WORKERS=1) "
    "or run the command again; what is finished is kept"
)


def run_over_drives(
    work: Work,
    drives: Sequence[str],
    *,
    module: str | Sequence[str],
    out: Path,
    inputs: Callable[[str], Sequence[Path | str]],
    settings: Mapping[str, Any],
    workers: int | None = None,
    resume: Path | None = None,
    target: Callable[[str], Path] | None = None,
    effort: Callable[[str], float] | None = None,
    frames: Callable[[str], int] | None = None,
    describe: Callable[[Summary], str] = str,
) -> dict[str, Summary]:
    """Call ``work(drive, path)`` for each of `drives`, in parallel, and leave each drive's file in `out`.

    Args:
        work: a picklable function (``functools.partial`` of a module-level one), or an object, of which each process
            has a copy of its own as long as it lives.
        module: dotted name of the stage's module; its code is part of the resume key (:func:`resume_key`).
        out: the stage's folder, for instance ``data/clouds/pseudo``.
        inputs: drive → what it is made from: files, whose contents are part of the key, or strings that stand for some.
        settings: JSON-able parameters that determine the files; part of the key.
        workers: processes; None means :func:`pipeline.base.console.default_workers`. Never changes a result.
        resume: where finished drives wait, locked; default ``.resume/<name of out>`` beside `out`. Never inside a DVC
            output.
        target: drive → where its file or folder ends up; default ``out/<drive>.h5``.
        effort: drive → how long it takes, in any unit; the longest start first, so that no worker ends alone.
            Default: the size of the input files.
        frames: drive → how many frames `work` tells :func:`pipeline.base.progress.advance` of, for a bar that counts
            frames. Default: it counts drives.
        describe: one drive's summary → what the log prints of it.

    Of what was in `out`, it removes the files of drives that an ``index.json`` there names and `drives` does not.

    Returns: drive → summary, in the order of `drives`.

    Raises InputError if another process writes the same folder; the first error of a worker after the drives in
    progress are done; what is finished is kept for the next run.
    """

    def plan(paths: Mapping[str, Path]) -> _Plan:
        todo = sorted(paths, key=effort or (lambda drive: _bytes(inputs(drive))), reverse=True)
        makers = {drive: _whole(drive, paths[drive]) for drive in todo}
        return _Plan(makers, len(todo), sum(map(frames, todo)) if frames else None)

    target = target or (lambda drive: out / f"{drive}.h5")
    return _make_all(work, drives, plan, module, out, inputs, settings, workers, resume, target, describe)


def run_over_frames(
    work: FrameWork,
    drives: Sequence[str],
    *,
    stage: str,
    params: Mapping[str, Any],
    frames: Callable[[str], Sequence[int]],
    out: Path,
    inputs: Callable[[str], Sequence[Path | str]],
    settings: Mapping[str, Any],
    workers: int | None = None,
    resume: Path | None = None,
    together: int = 1,
    total: Callable[[Sequence[Summary]], Summary] | None = None,
    describe: Callable[[Summary], str] = str,
) -> dict[str, Summary]:
    """Make each drive's file, ``out/<drive>.h5``, of blocks of its frames: see :mod:`pipeline.base.blocks`.

    A block is the unit of work and of what a kill can lose. Neither its size nor the number of workers changes a file.
    What is not told here is as in :func:`run_over_drives`.

    Args:
        work: a picklable function or object, as there: ``work(drive, rows, file)`` writes the frames in `rows`,
            numbered from 0, to `file`, in order, and tells :func:`pipeline.base.progress.advance` of each. An empty
            `rows` makes the datasets of a drive without frames.
        stage: its name, which is that of its module too.
        params: the params sections that stand in the files.
        frames: drive → the KITTI numbers of the frames that its file is made of.
        together: so many frames belong together in a block, from the first on, as those of a batch do.
        total: what the blocks of a drive return, in order → its summary. Default: their sums.

    Raises what :func:`run_over_drives` does; an InputError about a frame names drive and frame.
    """

    def plan(paths: Mapping[str, Path]) -> _Plan:
        drives = [_Drive(drive, stage, params, path, list(frames(drive)), together) for drive, path in paths.items()]
        kept = sum(len(drive.numbers) - drive.frames for drive in drives)
        if kept:
            print(f"{kept} frames of other drives kept from the run before", flush=True)
        makers = {drive.name: _from_blocks(drive, total or _sums) for drive in drives}
        return _Plan(makers, sum(len(drive.spans) for drive in drives), sum(drive.frames for drive in drives))

    return _make_all(
        work, drives, plan, f"stages.{stage}", out, inputs, settings, workers, resume,
        lambda drive: out / f"{drive}.h5", describe,
    )  # fmt: skip


class _Job(NamedTuple):
    where: str
    call: Callable[[Any], Any]
    """``call(work)``, in any process."""


_Steps = Generator[list[_Job], list[Any], tuple[Summary, float]]
"""How a drive is made: yields jobs to be done in any order, is sent what they return, returns summary and seconds."""


class _Plan(NamedTuple):
    makers: Mapping[str, _Steps]
    jobs: int  # at least, of the first steps of all
    frames: int | None  # that the jobs tell of; None if they tell of none


def _make_all(
    work: Any,
    drives: Sequence[str],
    plan: Callable[[Mapping[str, Path]], _Plan],
    module: str | Sequence[str],
    out: Path,
    inputs: Callable[[str], Sequence[Path | str]],
    settings: Mapping[str, Any],
    workers: int | None,
    resume: Path | None,
    target: Callable[[str], Path],
    describe: Callable[[Summary], str],
) -> dict[str, Summary]:
    kept = resume or out.parent / ".resume" / out.name
    with held(out, kept):
        paths = {
            drive: kept / (resume_key(module, {"drive": drive, **settings}, inputs(drive)) + target(drive).suffix)
            for drive in drives
        }
        todo = {drive: path for drive, path in paths.items() if not path.exists() or not _sidecar(path).is_file()}
        if len(todo) < len(drives):
            print(f"{len(drives) - len(todo)} of {len(drives)} drives kept from the run before", flush=True)
        _run(plan(todo), work, todo, workers or default_workers(), describe)
        summaries = {drive: json.loads(_sidecar(paths[drive]).read_text(encoding="utf-8")) for drive in drives}
        _move({path: target(drive) for drive, path in paths.items()}, out)
        shutil.rmtree(kept)
    return summaries


def _whole(drive: str, path: Path) -> _Steps:
    """Make a drive by one job."""
    ((summary, seconds),) = yield [_Job(drive, partial(_write_drive, drive, path))]
    return summary, seconds


def _write_drive(drive: str, path: Path, work: Work) -> tuple[Summary, float]:
    start = time.perf_counter()
    summary = work(drive, path)
    return summary, time.perf_counter() - start


class _Drive:
    """A drive that is made of blocks: `numbers` are its frames', `spans` the rows of its blocks."""

    def __init__(
        self, name: str, stage: str, params: Mapping[str, Any], path: Path, numbers: list[int], together: int
    ) -> None:
        self.name, self.numbers, self.path = name, numbers, path
        self.header = {"stage": stage, "drive": name.rpartition("/")[2], "params": params}
        size, count = -(-BLOCK_FRAMES // together) * together, len(numbers)
        self.spans = [range(start, min(start + size, count)) for start in range(0, count, size)] or [range(0)]
        self.blocks = [_blocks(path) / f"{span.start}-{span.stop}.npz" for span in self.spans]
        self.parts = [_blocks(path) / f"{part}-of-{len(self.spans)}.h5" for part in range(len(self.spans))]
        self.missing = [number for number, block in enumerate(self.blocks) if not block.is_file()]

    @property
    def frames(self) -> int:
        """How many are in the blocks that are missing."""
        return sum(len(self.spans[number]) for number in self.missing)


def _from_blocks(drive: _Drive, total: Callable[[Sequence[Summary]], Summary]) -> _Steps:
    """Make a drive's file of blocks: these, then the parts of the file, then the file."""
    jobs = []
    for number in drive.missing:
        span = drive.spans[number]
        frames = drive.numbers[span.start : span.stop]
        where = f"{drive.name}, frames {frames[0]} to {frames[-1]}" if frames else drive.name
        jobs.append(_Job(where, partial(_write_block, drive.name, drive.header, span, frames, drive.blocks[number])))
    yield jobs
    blocks, count = [read_block(path) for path in drive.blocks], len(drive.parts)
    seconds = yield [
        _Job(drive.name, partial(_write_part, blocks, number, count, path)) for number, path in enumerate(drive.parts)
    ]
    start = time.perf_counter()
    with DriveWriter(drive.path, **drive.header) as file:
        join(blocks, drive.parts, file)
    seconds += [time.perf_counter() - start, *(block.log["seconds"] for block in blocks)]
    return total([block.log["summary"] for block in blocks]), sum(seconds)


def _write_block(
    drive: str, header: Mapping[str, Any], rows: range, numbers: Sequence[int], path: Path, work: FrameWork
) -> None:
    start, before = time.perf_counter(), progress.done()
    try:
        with BlockWriter(path, **header) as file:
            file.log["summary"] = work(drive, rows, file)
            file.log["seconds"] = time.perf_counter() - start
    except Exception as error:
        done = progress.done() - before
        if done < len(numbers):  # else it is not about a frame
            _blame(error, f"{drive}, frame {numbers[done]}")
        raise


def _blame(error: Exception, where: str) -> None:
    """Have an error say where it happened: an InputError in the line that users read, others in their traceback."""
    if isinstance(error, InputError):
        raise type(error)(f"{where}: {error}") from error
    error.add_note(where)


def _write_part(blocks: Sequence[Block], part: int, parts: int, path: Path, _: object) -> float:
    start = time.perf_counter()
    encode(blocks, part, parts, path)
    return time.perf_counter() - start


def _sums(summaries: Sequence[Summary]) -> Summary:
    return {key: sum(summary[key] for summary in summaries) for key in summaries[0]}


def _move(targets: Mapping[Path, Path], out: Path) -> None:
    """Move finished files and folders to where they belong, and remove those of drives that are no longer wanted."""
    out.mkdir(parents=True, exist_ok=True)
    for folder in {target.parent for target in targets.values()}:
        sweep(folder)
    for path, target in targets.items():
        with replacing(target) as tmp:
            shutil.move(path, tmp)  # copies, if the stage's folder is a link to another disk
    # Earlier files may still be there (persist in dvc.yaml, or no DVC). Files of others stay.
    kinds = {(target.parent, target.suffix) for target in targets.values()}
    earlier = {folder / f"{drive}{suffix}" for folder, suffix in kinds for drive in indexed(folder)}
    for stale in earlier.difference(targets.values()):
        stale.unlink(missing_ok=True)


def _run(plan: _Plan, work: Any, paths: Mapping[str, Path], workers: int, describe: Callable[[Summary], str]) -> None:
    """Make drives as planned, and keep each with its summary beside its `paths`."""

    def finish(drive: str, summary: Summary, seconds: float) -> None:
        path = paths[drive]
        write_json(_sidecar(path), summary)
        shutil.rmtree(_blocks(path), ignore_errors=True)
        speed = f", {summary['frames'] / seconds:.1f} frames/s" if summary.get("frames") else ""
        if plan.frames is None:
            bar.update()
        line = f"{drive}: {describe(summary)}, {_size(path) / 1e6:.1f} MB, {seconds:.1f} s{speed}"
        tqdm.write(line, file=sys.stdout)
        sys.stdout.flush()

    with tqdm(
        total=len(plan.makers) if plan.frames is None else plan.frames,
        unit=" drives" if plan.frames is None else " frames",
        disable=not sys.stderr.isatty(),
    ) as bar:
        workers = min(workers, plan.jobs)
        if workers > 1:
            _run_side_by_side(plan, work, workers, finish, bar)
            return
        progress.listen(progress.nobody if plan.frames is None else bar.update)
        for drive, steps in plan.makers.items():
            finish(drive, *_run_alone(steps, work))


def _run_alone(steps: _Steps, work: Any) -> tuple[Summary, float]:
    try:
        jobs = next(steps)
        while True:
            jobs = steps.send([job.call(work) for job in jobs])
    except StopIteration as end:
        made: tuple[Summary, float] = end.value
        return made


class _Step:
    """Jobs of a drive that may be done in any order, and what they have returned."""

    def __init__(self, drive: str, jobs: Sequence[_Job]) -> None:
        self.drive, self.jobs = drive, jobs
        self.results: dict[int, Any] = {}

    @property
    def is_done(self) -> bool:
        return len(self.results) == len(self.jobs)


def _run_side_by_side(
    plan: _Plan, work: Any, workers: int, finish: Callable[[str, Summary, float], None], bar: tqdm
) -> None:
    queue: deque[tuple[_Step, int]] = deque()
    pending: dict[Future[Any], tuple[_Step, int]] = {}
    unstarted, failures = iter(plan.makers), list[Exception]()

    def go_on(drive: str, results: list[Any] | None) -> None:
        """Put the jobs of a drive's next step, or of the first, in front: few drives are unfinished at a time."""
        try:
            step = _Step(drive, plan.makers[drive].send(results))  # type: ignore[arg-type]  # None starts it
        except StopIteration as end:
            finish(drive, *end.value)
            return
        queue.extendleft((step, number) for number in reversed(range(len(step.jobs))))
        if not step.jobs:
            go_on(drive, [])

    def submit() -> None:
        while len(pending) < 2 * workers and not failures:  # one more each, so that nobody waits for this process
            while not queue and (drive := next(unstarted, None)) is not None:
                go_on(drive, None)
            if not queue:
                break
            step, number = queue.popleft()
            pending[pool.submit(with_work, step.jobs[number].call)] = step, number

    def settle(job: Future[Any]) -> None:
        step, number = pending.pop(job)
        try:
            step.results[number] = job.result()
            if step.is_done:
                go_on(step.drive, [step.results[number] for number in range(len(step.jobs))])
        except BrokenProcessPool:
            failures.append(InputError(_BROKEN.format(where=step.jobs[number].where)))
        except Exception as error:  # whatever it is, the other work is worth keeping
            failures.append(error)

    with processes(workers, max(1, default_workers() // workers), work) as (pool, done_frames):
        try:
            submit()
            while pending:
                done, _ = wait(pending, None if bar.disable else REFRESH_S, return_when=FIRST_COMPLETED)
                if plan.frames is not None:
                    bar.update(done_frames.value - bar.n)
                for job in done:
                    settle(job)
                if failures:
                    for job in [job for job in pending if job.cancel()]:
                        del pending[job]
                submit()
        finally:  # after Ctrl-C too: leaving the pool waits for what is not cancelled
            for job in pending:
                job.cancel()
    if failures:
        raise failures[0]


def run_side_by_side(work: Callable[[J], object], jobs: Sequence[J], workers: int | None = None) -> None:
    """Call ``work(job)`` for each of `jobs` in processes of one thread each: their number never changes a result.

    Args:
        work: a picklable function, which keeps its own results.
        workers: processes; None means :func:`pipeline.base.console.default_workers`.

    Raises the first error of a worker after what runs is done; the jobs that wait are left out.
    """
    with processes(min(workers or default_workers(), len(jobs)), threads=1) as (pool, _):
        waiting = [pool.submit(work, job) for job in jobs]
        try:
            for job in as_completed(waiting):
                job.result()
        except BrokenProcessPool as error:
            raise InputError(_BROKEN.format(where=jobs[waiting.index(job)])) from error
        finally:
            for job in waiting:
                job.cancel()


def _sidecar(path: Path) -> Path:
    return path.with_suffix(".json")


def _blocks(path: Path) -> Path:
    """Return the folder where what a drive's file is made of waits."""
    return path.with_suffix(".blocks")


def _size(path: Path) -> int:
    return sum(file.stat().st_size for file in path.rglob("*")) if path.is_dir() else path.stat().st_size


def _bytes(inputs: Sequence[Path | str]) -> int:
    return sum(path.stat().st_size for path in inputs if isinstance(path, Path))
