"""Make drives in parallel, with progress and resume.

DVC deletes a stage's outputs before it runs the stage. So finished drives wait in ``data/.resume/<stage>/`` under a key
that hashes everything that determines them, until the stage's folder is complete.
"""

import hashlib
import json
import os
import shutil
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import contextmanager
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel
from tqdm import tqdm

from pipeline.base.atomic import replacing, stage_folder, sweep
from pipeline.base.errors import InputError, error_context, take_frame
from pipeline.base.executors import executor
from pipeline.base.files import size_of
from pipeline.base.resume import stage_key
from pipeline.base.store import indexed, write_json

J = TypeVar("J")
Summary = dict[str, Any]
Work = Callable[[Path], Summary]
_POLL_S = 0.5  # how often new workers of a cluster are looked for


class Job(NamedTuple):
    """One drive of a stage.

    Attributes:
        drive: its name in messages, unique in the stage.
        target: final path of its file or folder.
        inputs: files and strings. With the code and the stage's settings, they determine the content.
        work: picklable. Writes the file or folder to a path in one step and returns a JSON-able summary.
    """

    drive: str
    target: Path
    inputs: Sequence[Path | str]
    work: Work


@contextmanager
def run_over_drives(
    stage: str,
    settings: BaseModel | Mapping[str, Any],
    jobs: Sequence[Job],
    out: Path,
    describe: Callable[[Summary], str] = str,
    workers: int | None = None,
) -> Iterator[dict[str, Summary]]:
    """Make all drives, then yield drive → summary in the order of `jobs`, holding the lock of the stage's folder `out`.

    The block writes the stage's other files, for instance its index, and removes obsolete ones. Finished drives are
    kept for the next run until the block ends without error, so that a kill or an error loses none of them.

    Args:
        stage: its name in ``dvc.yaml``; ``graphs@NAME`` for an entry, whose `out` is a folder in the stage's folder.
        settings: a section, or JSON-able; part of :func:`pipeline.base.resume.stage_key`.
        jobs: the largest files as inputs start first; otherwise in their order.
        describe: a drive's summary → text for the log.
        workers: processes; None: :func:`pipeline.base.executors.default_workers`. 1: this process, otherwise the
            workers of a Dask cluster if there is one. Never changes a result.

    Files of drives that the earlier ``index.json`` names and `jobs` does not are removed. Raises InputError if another
    process writes the same folder; the first error of a worker after the drives in progress are done.
    """
    settings = settings.model_dump(mode="json") if isinstance(settings, BaseModel) else settings
    name, _, entry = stage.partition("@")
    with stage_folder(out, entry=bool(entry)) as pending:
        out.mkdir(parents=True, exist_ok=True)
        keys = {job.drive: stage_key(name, {"drive": job.drive, **settings}, job.inputs) for job in jobs}
        paths = {
            job.drive: pending / f"{job.drive.replace('/', '-')}-{keys[job.drive]}{job.target.suffix}" for job in jobs
        }
        todo = [job for job in jobs if _read_summary(paths[job.drive]) is None]
        kept = len(jobs) - len(todo)
        if kept:
            print(f"{kept} of {len(jobs)} drives kept from the run before", flush=True)
        todo.sort(key=_input_bytes, reverse=True)
        tasks = [(job.drive, paths[job.drive], job.work) for job in todo]
        with tqdm(total=len(jobs), initial=kept, unit=" drives", disable=not sys.stderr.isatty()) as bar:
            for (drive, path, _), result in run_jobs(_make, tasks, workers=workers, name=itemgetter(0)):
                bar.update()
                tqdm.write(_log_line(drive, path, describe, *result), file=sys.stdout)
                sys.stdout.flush()
        _publish({paths[job.drive]: job.target for job in jobs})
        yield {drive: _read_summary(path) or {} for drive, path in paths.items()}
        shutil.rmtree(pending)


def run_jobs(
    work: Callable[[J], Any],
    jobs: Sequence[J],
    *,
    workers: int | None = None,
    threads: int | None = None,
    name: Callable[[J], str] = str,
) -> Iterator[tuple[J, Any]]:
    """Yield each job with the result of ``work(job)`` as they finish, in parallel.

    Args:
        workers: as in :func:`run_over_drives`.
        threads: of each process, and no job runs in this process; None: the cores are divided among the processes.
        name: job → its name in errors.

    Raises the first error after the jobs in progress are done; no other job is started.
    """
    if not jobs:
        return
    failures: list[BaseException] = []
    running: dict[Future[Any], J] = {}
    waiting = deque(jobs)
    with executor(workers, len(jobs), threads) as pool:
        while running or (waiting and not failures):
            # No more than can run at once, so that after a failure there is nothing to cancel.
            while waiting and not failures and len(running) < pool.capacity():
                job = waiting.popleft()
                try:
                    running[pool.executor.submit(work, job)] = job
                except BrokenExecutor:
                    failures.append(_worker_died([name(job) for job in (*running.values(), job)]))
            for future in wait(running, _POLL_S, FIRST_COMPLETED).done:
                failure = future.exception()
                if failure is None:
                    yield running[future], future.result()
                else:  # whatever it is, the jobs in progress are worth finishing
                    died = isinstance(failure, BrokenExecutor) or type(failure).__name__ == "KilledWorker"  # of Dask
                    names = [name(job) for job in running.values()]
                    failures.append(_worker_died(names) if died else failure)
                del running[future]
        if failures:
            raise failures[0]


def _input_bytes(job: Job) -> int:
    return sum(path.stat().st_size for path in job.inputs if isinstance(path, Path))


def _log_line(drive: str, path: Path, describe: Callable[[Summary], str], summary: Summary, seconds: float) -> str:
    rate = f", {summary['frames'] / seconds:.1f} frames/s" if summary.get("frames") else ""
    return f"{drive}: {describe(summary)}, {size_of(path) / 1e6:.1f} MB, {seconds:.1f} s{rate}"


def _worker_died(drives: Sequence[str]) -> InputError:
    fix = "Use fewer workers (STEER_WORKERS=1) or repeat the command: finished drives are kept"
    return InputError("a worker process died (out of memory?)", f"at or near {', '.join(drives)}", fix)


def _make(item: tuple[str, Path, Work]) -> tuple[Summary, float]:
    """Make one drive, and its summary beside it; an error names the drive and, where known, the frame."""
    drive, path, work = item
    start = time.perf_counter()
    for leftover in (path, _sidecar(path)):  # damaged, or from a kill between the two
        _remove(leftover)
    try:
        summary = work(path)
    except Exception as error:
        frame = take_frame()
        where = drive if frame is None else f"{drive} frame {frame}"
        if isinstance(error, InputError):
            with error_context(where):
                raise
        error.add_note(f"while processing {where}")
        raise
    write_json(_sidecar(path), {"summary": summary, "sha256": _digest(summary)})
    return summary, time.perf_counter() - start


def _publish(targets: Mapping[Path, Path]) -> None:
    """Link finished files and folders to their final paths, and remove files of drives that are no longer listed."""
    sweep(*{target.parent for target in targets.values()})
    for path, target in targets.items():
        with replacing(target) as tmp:
            if path.is_dir():
                shutil.copytree(path, tmp, copy_function=_link)
            else:
                _link(path, tmp)
    # Earlier files may still be there (persist in dvc.yaml, or no DVC).
    kinds = {(target.parent, target.suffix) for target in targets.values()}
    earlier = {folder / f"{drive}{suffix}" for folder, suffix in kinds for drive in indexed(folder)}
    for stale in earlier.difference(targets.values()):
        if stale.is_file():
            stale.unlink()


def _link(path: str | Path, target: str | Path) -> None:
    """Give a file a second name; copy it to another disk, and where there are no hard links."""
    try:
        os.link(path, target)
    except OSError:
        shutil.copyfile(path, target)


def _sidecar(path: Path) -> Path:
    return path.with_name(f"{path.name}.json")


def _read_summary(path: Path) -> Summary | None:
    """Return the summary beside a finished file or folder; None if one of the two is missing or damaged."""
    try:
        sidecar = json.loads(_sidecar(path).read_text(encoding="utf-8"))
        intact = sidecar["sha256"] == _digest(sidecar["summary"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return None
    return sidecar["summary"] if intact and path.exists() else None


def _digest(summary: Summary) -> str:
    return hashlib.sha256(json.dumps(summary, sort_keys=True).encode()).hexdigest()


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
