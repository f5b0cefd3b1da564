"""Run a function over drives in parallel, with progress and resume.

DVC deletes a stage's outputs before it runs the stage. So finished drives wait in ``data/.resume/<stage>/`` under a key
that hashes everything that determines them, and are moved into the stage's folder when all are done.
"""

import json
import shutil
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from pipeline.base import progress
from pipeline.base.atomic import exclusive, replacing, sweep
from pipeline.base.errors import InputError, error_context
from pipeline.base.executors import executor
from pipeline.base.files import size_of
from pipeline.base.resume import stage_key
from pipeline.base.store import indexed, write_json

J = TypeVar("J")
Summary = dict[str, Any]
Work = Callable[[str, Path], Summary]
_POLL_S = 0.5  # how often frames are counted, and new workers of a cluster looked for


def run_over_drives(
    work: Work,
    drives: Sequence[str],
    *,
    out: Path,
    stage: str,
    settings: Mapping[str, Any],
    inputs: Callable[[str], Sequence[Path | str]],
    workers: int | None = None,
    pending: Path | None = None,
    target: Callable[[str], Path] | None = None,
    frames: Callable[[str], int] | None = None,
    describe: Callable[[Summary], str] = str,
) -> dict[str, Summary]:
    """Call ``work(drive, path)`` for each of `drives` in parallel, and leave each drive's file in `out`.

    Args:
        work: picklable. Writes the drive's file or folder to `path` in one step and returns a JSON-able summary.
        out: the stage's folder, for instance ``data/clouds/pseudo``.
        stage, settings: name in ``dvc.yaml``, and JSON-able; with the code and `inputs` they determine a drive's
            file: :func:`pipeline.base.resume.stage_key`.
        inputs: drive → files whose contents, and strings which, determine its file.
        workers: processes; None: :func:`pipeline.base.executors.default_workers`. 1: this process, otherwise the
            workers of a Dask cluster if there is one. Never changes a result.
        pending: where finished drives wait; default ``.resume/<name of out>`` beside `out`. Never inside a DVC output.
        target: drive → final path of its file or folder; default ``out/<drive>.h5``.
        frames: drive → how many frames `work` counts with :mod:`pipeline.base.progress`; the longest drive starts
            first. Default: one each.
        describe: a drive's summary → text for the log.

    Files in `out` of drives that its ``index.json`` names and `drives` does not are removed. Returns drive → summary,
    in the order of `drives`. Raises InputError if another process writes the same folder; the first error of a worker
    after the drives in progress are done. What is finished is kept for the next run.
    """
    pending = pending or out.parent / ".resume" / out.name
    targets = {drive: target(drive) if target else out / f"{drive}.h5" for drive in drives}
    with exclusive(out, pending):
        keys = {drive: stage_key(stage, {"drive": drive, **settings}, inputs(drive)) for drive in drives}
        paths = {
            drive: pending / f"{drive.replace('/', '-')}-{keys[drive]}{path.suffix}" for drive, path in targets.items()
        }
        todo = [drive for drive, path in paths.items() if not path.exists() or not _sidecar(path).is_file()]
        if len(todo) < len(drives):
            print(f"{len(drives) - len(todo)} of {len(drives)} drives kept from the run before", flush=True)
        counts = {drive: frames(drive) if frames else 1 for drive in drives}
        done = sum(counts.values()) - sum(counts[drive] for drive in todo)
        todo.sort(key=counts.__getitem__, reverse=True)
        unit = " frames" if frames else " drives"
        with tqdm(total=sum(counts.values()), initial=done, unit=unit, disable=not sys.stderr.isatty()) as bar:
            jobs = [(drive, paths[drive]) for drive in todo]
            make = partial(_run, work=work)
            for job, result in run_jobs(make, jobs, workers=workers, counter=bar.update, name=itemgetter(0)):
                done += counts[job[0]]
                bar.update(max(0, done - bar.n))  # a cluster does not count frames
                tqdm.write(_log_line(job, result, describe), file=sys.stdout)
                sys.stdout.flush()
        summaries = {drive: json.loads(_sidecar(path).read_text(encoding="utf-8")) for drive, path in paths.items()}
        _publish({paths[drive]: path for drive, path in targets.items()}, out)
        shutil.rmtree(pending)
    return summaries


def run_jobs(
    work: Callable[[J], Any],
    jobs: Sequence[J],
    *,
    workers: int | None = None,
    threads: int | None = None,
    counter: Callable[[int], object] = lambda frames: None,
    name: Callable[[J], str] = str,
) -> Iterator[tuple[J, Any]]:
    """Yield each job with the result of ``work(job)`` as they finish, in parallel.

    Args:
        workers: as in :func:`run_over_drives`.
        threads: of each process, in which case none runs in this process; None: the cores are divided among them.
        counter: called with numbers of frames as they are done.
        name: job → how an error names it.

    Raises the first error after the jobs in progress are done; no other job is started.
    """
    if not jobs:
        return
    failures: list[BaseException] = []
    running: dict[Future[Any], J] = {}
    waiting = deque(jobs)
    with executor(workers, len(jobs), counter, threads) as pool:
        while running or (waiting and not failures):
            # No more than can run at once, so that after a failure there is nothing to cancel.
            while waiting and not failures and len(running) < pool.capacity():
                job = waiting.popleft()
                try:
                    running[pool.executor.submit(work, job)] = job
                except BrokenExecutor:
                    failures.append(_worker_died([name(job) for job in (*running.values(), job)]))
            finished = wait(running, _POLL_S, FIRST_COMPLETED).done
            pool.report()
            for future in finished:
                failure = future.exception()
                if failure is None:
                    yield running[future], future.result()
                else:  # whatever it is, the jobs in progress are worth finishing
                    died = isinstance(failure, BrokenExecutor) or type(failure).__name__ == "KilledWorker"  # of Dask
                    near = [name(job) for job in running.values()]
                    failures.append(_worker_died(near) if died else failure)
                del running[future]
        if failures:
            raise failures[0]


def _log_line(job: tuple[str, Path], result: tuple[Summary, float], describe: Callable[[Summary], str]) -> str:
    (drive, path), (summary, seconds) = job, result
    rate = f", {summary['frames'] / seconds:.1f} frames/s" if summary.get("frames") else ""
    return f"{drive}: {describe(summary)}, {size_of(path) / 1e6:.1f} MB, {seconds:.1f} s{rate}"


def _worker_died(jobs: Sequence[str]) -> InputError:
    fix = "Use fewer workers (STEER_WORKERS=1) or repeat the command: finished drives are kept"
    return InputError("a worker process died (out of memory?)", f"at or near {', '.join(jobs)}", fix)


def _run(job: tuple[str, Path], work: Work) -> tuple[Summary, float]:
    """Make one drive's file with its summary beside it; an error names the drive and, where known, the frame."""
    drive, path = job
    start = time.perf_counter()
    try:
        summary = work(drive, path)
    except Exception as error:
        frame = progress.take_frame()
        where = drive if frame is None else f"{drive} frame {frame}"
        if isinstance(error, InputError):
            with error_context(where):
                raise
        error.add_note(f"while processing {where}")
        raise
    write_json(_sidecar(path), summary)
    return summary, time.perf_counter() - start


def _publish(targets: Mapping[Path, Path], out: Path) -> None:
    """Move finished files and folders to their final paths, and remove those of drives that are no longer listed."""
    out.mkdir(parents=True, exist_ok=True)
    for folder in {target.parent for target in targets.values()}:
        sweep(folder)
    for path, target in targets.items():
        with replacing(target) as tmp:
            shutil.move(path, tmp)  # copies, if the stage's folder is a link to another disk
    # Earlier files may still be there (persist in dvc.yaml, or no DVC).
    kinds = {(target.parent, target.suffix) for target in targets.values()}
    earlier = {folder / f"{drive}{suffix}" for folder, suffix in kinds for drive in indexed(folder)}
    for stale in earlier.difference(targets.values()):
        if stale.is_file():
            stale.unlink()


def _sidecar(path: Path) -> Path:
    return path.with_name(f"{path.name}.json")
