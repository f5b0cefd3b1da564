"""Run a function over drives, or over blocks of their frames: by whom, progress, going on after a kill.

DVC deletes a stage's outputs before it runs the stage, so finished drives and blocks wait in ``data/.resume/<stage>/``
under a key that hashes all that determines their drive; drives are moved into the stage's folder when all are done.
"""

import json
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from tqdm import tqdm

from pipeline.base import cluster, making, progress
from pipeline.base.atomic import replacing, sweep
from pipeline.base.blocks import BlockWriter
from pipeline.base.console import default_workers
from pipeline.base.jobs import Job, Steps, Workers, run_alone, run_by
from pipeline.base.jobs import Summary as Summary
from pipeline.base.lock import held
from pipeline.base.making import Blocks, Total
from pipeline.base.processes import processes
from pipeline.base.resume import resume_key
from pipeline.base.store import indexed, write_json

BLOCK_FRAMES = 32  # of a block; changes no byte of a file
J = TypeVar("J")
Work = Callable[[str, Path], Summary]
"""``work(drive, path)`` writes the drive's file or folder to `path` in one step and returns what the log says."""
FrameWork = Callable[[str, range, BlockWriter], Summary]
"""``work(drive, rows, file)`` writes a drive's frames in `rows` to `file` and returns what the log says of them."""
FolderWork = Callable[[str, range, Path], Summary]
"""The same into a folder."""


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
        workers: processes; None means :func:`pipeline.base.console.default_workers`. Never changes a result. With
            ``STEER_SCHEDULER``, those of a cluster do the work: :mod:`pipeline.base.cluster`.
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
        makers = {drive: making.whole(drive, paths[drive]) for drive in todo}
        return _Plan(makers, len(todo), sum(map(frames, todo)) if frames else None)

    target = target or (lambda drive: out / f"{drive}.h5")
    return _make_all(work, drives, plan, module, out, inputs, settings, workers, resume, target, describe)


def run_over_frames(
    work: FrameWork | FolderWork,
    drives: Sequence[str],
    *,
    frames: Callable[[str], Sequence[int]],
    params: Mapping[str, Any] | None,
    stage: str,
    out: Path,
    inputs: Callable[[str], Sequence[Path | str]],
    settings: Mapping[str, Any],
    workers: int | None = None,
    resume: Path | None = None,
    target: Callable[[str], Path] | None = None,
    block_frames: int | None = None,
    together: int = 1,
    chained: bool = False,
    total: Total | None = None,
    describe: Callable[[Summary], str] = str,
) -> dict[str, Summary]:
    """Make each drive's file or folder of blocks of its frames: see :mod:`pipeline.base.blocks`.

    A block is the unit of work and of what a kill can lose. Neither its size nor the number of workers changes a byte.
    What is not told here is as in :func:`run_over_drives`.

    Args:
        work: a picklable function or object, as there. ``work(drive, rows, file)`` writes the frames in `rows`,
            numbered from 0, to `file`, in order, and tells :func:`pipeline.base.progress.advance` of each. An empty
            `rows` makes the datasets of a drive without frames.
        frames: drive → the KITTI numbers of the frames that it is made of.
        params: the params sections that stand in the files; None: drives are folders, and `work` gets a path.
        stage: its name, which is that of its module too.
        block_frames: how many a block has at least; default BLOCK_FRAMES.
        together: so many frames belong together in a block, from the first on, as those of a batch do.
        chained: blocks of a drive are made one after the other: ``file.before`` is what the block before left as
            ``file.after``.
        total: default: the sums of what the blocks return.

    Raises what :func:`run_over_drives` does; an InputError about a frame names drive and frame.
    """
    size = -(-(block_frames or BLOCK_FRAMES) // together) * together

    def plan(paths: Mapping[str, Path]) -> _Plan:
        suffix = ".part" if params is None else ".npz"
        blocks = [Blocks(drive, path, list(frames(drive)), size, suffix) for drive, path in paths.items()]
        blocks.sort(key=lambda one: len(one.numbers), reverse=True)  # the longest chain ends last
        kept = sum(len(one.numbers) - one.frames for one in blocks)
        if kept:
            print(f"{kept} frames of other drives kept from the run before", flush=True)
        makers = {one.drive: steps(one) for one in blocks}
        return _Plan(makers, sum(len(one.spans) for one in blocks), sum(one.frames for one in blocks))

    def steps(blocks: Blocks) -> Steps:
        if params is None:
            return making.folder_of_blocks(blocks, total or _sums)
        header = {"stage": stage, "drive": Path(blocks.drive).name, "params": params}
        return making.file_of_blocks(blocks, header, chained, total or _sums)

    target = target or (lambda drive: out / f"{drive}.h5")
    return _make_all(work, drives, plan, f"stages.{stage}", out, inputs, settings, workers, resume, target, describe)


def _sums(summaries: Sequence[Summary]) -> Summary:
    return {key: sum(summary[key] for summary in summaries) for key in summaries[0]}


class _Plan(NamedTuple):
    makers: Mapping[str, Steps]
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
    with held(out, kept) as lock:
        paths = {
            drive: kept / (resume_key(module, {"drive": drive, **settings}, inputs(drive)) + target(drive).suffix)
            for drive in drives
        }
        todo = {drive: path for drive, path in paths.items() if not path.exists() or not _sidecar(path).is_file()}
        if len(todo) < len(drives):
            print(f"{len(drives) - len(todo)} of {len(drives)} drives kept from the run before", flush=True)
        hire = partial(_hired, work, module, lock)
        _run(plan(todo), work, hire, todo, workers or default_workers(), describe)
        summaries = {drive: json.loads(_sidecar(paths[drive]).read_text(encoding="utf-8")) for drive in drives}
        _move({path: target(drive) for drive, path in paths.items()}, out)
        shutil.rmtree(kept)
    return summaries


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


Hire = Callable[[int, int], AbstractContextManager[Workers]]


def _hired(
    work: Any, module: str | Sequence[str], mark: Path, workers: int, threads: int
) -> AbstractContextManager[Workers]:
    """Return who does the work: a cluster's workers if the user has one, else so many processes of so many threads."""
    if address := cluster.scheduler():
        return cluster.joined(address, work, module, mark)
    return processes(workers, threads, work)


def _run(
    plan: _Plan, work: Any, hire: Hire, paths: Mapping[str, Path], workers: int, describe: Callable[[Summary], str]
) -> None:
    """Make drives as planned, and keep each with its summary beside its `paths`."""
    by_frame = plan.frames is not None

    def finish(drive: str, summary: Summary, seconds: float) -> None:
        path = paths[drive]
        write_json(_sidecar(path), summary)
        shutil.rmtree(making.folder(path), ignore_errors=True)
        speed = f", {summary['frames'] / seconds:.1f} frames/s" if summary.get("frames") else ""
        if not by_frame:
            bar.update()
        line = f"{drive}: {describe(summary)}, {_size(path) / 1e6:.1f} MB, {seconds:.1f} s{speed}"
        tqdm.write(line, file=sys.stdout)
        sys.stdout.flush()

    with tqdm(
        total=plan.frames if by_frame else len(plan.makers),
        unit=" frames" if by_frame else " drives",
        disable=not sys.stderr.isatty(),
    ) as bar:
        workers = min(workers, plan.jobs)
        if workers > 1 or (workers and cluster.scheduler()):
            with hire(workers, max(1, default_workers() // workers)) as team:
                run_by(team, plan.makers, finish, bar, by_frame)
            return
        progress.listen(bar.update if by_frame else progress.nobody)
        run_alone(plan.makers, work, finish)


def run_side_by_side(
    work: Callable[[J], object],
    jobs: Sequence[J],
    *,
    module: str | Sequence[str],
    mark: Path,
    workers: int | None = None,
) -> None:
    """Call ``work(job)`` for each of `jobs` in processes of one thread each: their number never changes a result.

    Args:
        work: a picklable function, which keeps its own results.
        module: dotted names of what does the work, which a cluster's workers must have as this process has it.
        mark: a file of this run, by which a cluster's workers find out whether they see the same files.
        workers: as in :func:`run_over_drives`.

    Raises the first error of a worker after what runs is done; the jobs that wait are left out.
    """
    makers = {str(number): _lone(job) for number, job in enumerate(jobs)}
    count = min(workers or default_workers(), len(jobs))
    with tqdm(disable=True) as bar, _hired(work, module, mark, count, threads=1) as team:
        run_by(team, makers, lambda *_: None, bar, by_frame=False)


def _lone(job: Any) -> Steps:
    yield [Job(str(job), partial(_call_with, job))]
    return {}, 0.0


def _call_with(job: J, work: Callable[[J], object]) -> None:
    work(job)


def _sidecar(path: Path) -> Path:
    return path.with_suffix(".json")


def _size(path: Path) -> int:
    return sum(file.stat().st_size for file in path.rglob("*")) if path.is_dir() else path.stat().st_size


def _bytes(inputs: Sequence[Path | str]) -> int:
    return sum(path.stat().st_size for path in inputs if isinstance(path, Path))
