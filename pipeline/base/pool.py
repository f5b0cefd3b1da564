"""Run a function over drives: worker processes, progress, and going on after a kill.

DVC deletes a stage's outputs before it runs the stage, so finished drives wait in ``data/.resume/<stage>/`` under a
key that hashes all that determines them; they are moved into the stage's folder when every drive is done.
"""

import json
import multiprocessing
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from pipeline.base import progress
from pipeline.base.atomic import replacing, sweep
from pipeline.base.console import default_workers
from pipeline.base.errors import InputError
from pipeline.base.lock import held
from pipeline.base.resume import resume_key
from pipeline.base.store import indexed, write_json

REFRESH_S = 0.5  # of the bar, while workers count
J = TypeVar("J")
Summary = dict[str, Any]
Work = Callable[[str, Path], Summary]
"""``work(drive, path)`` writes the drive's file or folder to `path` in one step and returns what the log says."""
_BROKEN = (
    "a worker process died (out of memory?) at or near {drive}: use fewer workers (STEER_WORKERS=1) "
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
        work: a picklable function (``functools.partial`` of a module-level one).
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
    kept = resume or out.parent / ".resume" / out.name
    target = target or (lambda drive: out / f"{drive}.h5")
    with held(out, kept):
        paths = {
            drive: kept / (resume_key(module, {"drive": drive, **settings}, inputs(drive)) + target(drive).suffix)
            for drive in drives
        }
        todo = [drive for drive in drives if not paths[drive].exists() or not _sidecar(paths[drive]).is_file()]
        todo.sort(key=effort or (lambda drive: _bytes(inputs(drive))), reverse=True)
        if len(todo) < len(drives):
            print(f"{len(drives) - len(todo)} of {len(drives)} drives kept from the run before", flush=True)
        with tqdm(
            total=sum(map(frames, todo)) if frames else len(todo),
            unit=" frames" if frames else " drives",
            disable=not sys.stderr.isatty(),
        ) as bar:
            todo_paths = {drive: paths[drive] for drive in todo}
            _run(work, todo_paths, workers or default_workers(), describe, bar, bool(frames))

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


def _run(
    work: Work,
    paths: Mapping[str, Path],
    workers: int,
    describe: Callable[[Summary], str],
    bar: tqdm,
    by_frame: bool,
) -> None:
    def finish(drive: str, summary: Summary, seconds: float) -> None:
        write_json(_sidecar(paths[drive]), summary)
        speed = f", {summary['frames'] / seconds:.1f} frames/s" if summary.get("frames") else ""
        if not by_frame:
            bar.update()
        line = f"{drive}: {describe(summary)}, {_size(paths[drive]) / 1e6:.1f} MB, {seconds:.1f} s{speed}"
        tqdm.write(line, file=sys.stdout)
        sys.stdout.flush()

    workers = min(workers, len(paths))
    if workers <= 1:
        progress.listen(bar.update if by_frame else progress.nobody)
        for drive, path in paths.items():
            finish(drive, *_timed(work, drive, path))
        return
    failures: list[Exception] = []
    with _processes(workers, threads=max(1, default_workers() // workers)) as (pool, done_frames):
        jobs = {pool.submit(_timed, work, drive, path): drive for drive, path in paths.items()}
        pending = set(jobs)
        try:
            while pending:
                done, pending = wait(pending, None if bar.disable else REFRESH_S, return_when=FIRST_COMPLETED)
                if by_frame:
                    bar.update(done_frames.value - bar.n)
                for job in done:
                    try:
                        finish(jobs[job], *job.result())
                    except BrokenProcessPool:
                        failures.append(InputError(_BROKEN.format(drive=jobs[job])))
                    except Exception as error:  # whatever it is, the other drives' work is worth keeping
                        failures.append(error)
                if failures:
                    pending = {job for job in pending if not job.cancel()}
        finally:  # after Ctrl-C too: leaving the pool waits for what is not cancelled
            for job in jobs:
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
    with _processes(min(workers or default_workers(), len(jobs)), threads=1) as (pool, _):
        waiting = [pool.submit(work, job) for job in jobs]
        try:
            for job in as_completed(waiting):
                job.result()
        except BrokenProcessPool as error:
            raise InputError(_BROKEN.format(drive=jobs[waiting.index(job)])) from error
        finally:
            for job in waiting:
                job.cancel()


@contextmanager
def _processes(workers: int, threads: int) -> "Iterator[tuple[ProcessPoolExecutor, Synchronized[int]]]":
    """Yield worker processes whose libraries use so many threads, and the counter of the frames that they have done."""
    # "spawn": a forked child would inherit the thread pools of torch, OpenCV and Open3D in an unusable state.
    context = multiprocessing.get_context("spawn")
    done_frames = context.Value("q", 0)
    with _Environment(OMP_NUM_THREADS=str(threads)), ProcessPoolExecutor(
        workers, mp_context=context, initializer=_start_worker, initargs=(threads, done_frames)
    ) as pool:  # fmt: skip
        yield pool, done_frames


def _timed(work: Work, drive: str, path: Path) -> tuple[Summary, float]:
    start = time.perf_counter()
    summary = work(drive, path)
    return summary, time.perf_counter() - start


def _start_worker(threads: int, done_frames: "Synchronized[int]") -> None:
    """Keep a worker's libraries from using every core each, and the worker from outliving a killed stage."""
    import cv2

    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # as in a shell's background job, which goes on
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C: end without a traceback each
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    cv2.setNumThreads(threads)
    progress.listen_with(done_frames)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(threads)


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


class _Environment:
    """Environment variables for the children started inside the block."""

    def __init__(self, **variables: str) -> None:
        self._new = variables

    def __enter__(self) -> None:
        self._old = {name: os.environ.get(name) for name in self._new}
        os.environ.update(self._new)

    def __exit__(self, *_: object) -> None:
        for name, value in self._old.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _sidecar(path: Path) -> Path:
    return path.with_suffix(".json")


def _size(path: Path) -> int:
    return sum(file.stat().st_size for file in path.rglob("*")) if path.is_dir() else path.stat().st_size


def _bytes(inputs: Sequence[Path | str]) -> int:
    return sum(path.stat().st_size for path in inputs if isinstance(path, Path))
