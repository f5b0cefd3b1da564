"""Run a function over drives in parallel, with progress and resume.

DVC deletes a stage's outputs before it runs the stage. So finished drives wait in ``data/.resume/<stage>/`` under a key
that hashes everything that determines them, and are moved into the stage's folder when all are done.
"""

import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from pipeline.base import progress
from pipeline.base.atomic import replacing, sweep
from pipeline.base.errors import InputError, error_context
from pipeline.base.executors import SerialExecutor, default_workers, executor
from pipeline.base.lock import exclusive
from pipeline.base.store import indexed, write_json

J = TypeVar("J")
Summary = dict[str, Any]
Work = Callable[[str, Path], Summary]


def run_over_drives(
    work: Work,
    drives: Sequence[str],
    *,
    out: Path,
    key: Callable[[str], str],
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
        key: drive → hash of everything that determines its file: :func:`pipeline.base.resume.stage_key`.
        workers: processes; None: :func:`pipeline.base.executors.default_workers`. Never changes a result.
        pending: where finished drives wait; default ``.resume/<name of out>`` beside `out`. Never inside a DVC output.
        target: drive → final path of its file or folder; default ``out/<drive>.h5``.
        frames: drive → how many frames `work` counts with :mod:`pipeline.base.progress`; the longest drive starts
            first. Default: one each.
        describe: a drive's summary → text for the log.

    Files in `out` of drives that its ``index.json`` names and `drives` does not are removed.

    Returns: drive → summary, in the order of `drives`.

    Raises InputError if another process writes the same folder; the first error of a worker after the drives in
    progress are done. What is finished is kept for the next run.
    """
    pending = pending or out.parent / ".resume" / out.name
    target = target or (lambda drive: out / f"{drive}.h5")
    with exclusive(out, pending):
        paths = {drive: pending / (key(drive) + target(drive).suffix) for drive in drives}
        todo = [drive for drive in drives if not paths[drive].exists() or not _sidecar(paths[drive]).is_file()]
        if len(todo) < len(drives):
            print(f"{len(drives) - len(todo)} of {len(drives)} drives kept from the run before", flush=True)
        counts = {drive: frames(drive) if frames else 1 for drive in todo}
        todo.sort(key=counts.__getitem__, reverse=True)
        unit = " frames" if frames else " drives"
        with tqdm(total=sum(counts.values()), unit=unit, disable=not sys.stderr.isatty()) as bar:
            jobs = [(drive, paths[drive]) for drive in todo]
            for (drive, path), (summary, seconds) in run_jobs(
                _Drive(work), jobs, workers=workers, counter=bar.update if frames else None, name=lambda job: job[0]
            ):
                if not frames:
                    bar.update()
                rate = f", {summary['frames'] / seconds:.1f} frames/s" if summary.get("frames") else ""
                line = f"{drive}: {describe(summary)}, {_size(path) / 1e6:.1f} MB, {seconds:.1f} s{rate}"
                tqdm.write(line, file=sys.stdout)
                sys.stdout.flush()
        summaries = {drive: json.loads(_sidecar(paths[drive]).read_text(encoding="utf-8")) for drive in drives}
        _publish({path: target(drive) for drive, path in paths.items()}, out)
        shutil.rmtree(pending)
    return summaries


def run_jobs(
    work: Callable[[J], Any],
    jobs: Sequence[J],
    *,
    workers: int | None = None,
    threads: int | None = None,
    counter: Callable[[int], object] | None = None,
    name: Callable[[J], str] = str,
) -> Iterator[tuple[J, Any]]:
    """Yield each job with the result of ``work(job)`` as they finish, in parallel.

    Args:
        threads: of each worker process; None: the cores are divided among the workers.
        counter: called with numbers of frames as they are done.
        name: job → how an error names it.

    Raises the first error after the jobs in progress are done; waiting jobs are cancelled.
    """
    count = min(workers or default_workers(), len(jobs))
    if not count:
        return
    failures: list[Exception] = []
    pending: dict[Future[Any], J] = {}
    waiting = iter(jobs)
    with executor(count, counter or (lambda frames: None), threads) as pool:
        # A serial executor works within submit().
        limit = 1 if isinstance(pool, SerialExecutor) else len(jobs)
        while True:
            while len(pending) < limit and not failures and (job := next(waiting, None)) is not None:
                pending[pool.submit(work, job)] = job
            if not pending:
                break
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                try:
                    yield pending[future], future.result()
                except CancelledError:
                    pass
                except BrokenExecutor:
                    failures.append(_worker_died([name(job) for job in pending.values()][:count]))
                except Exception as error:  # whatever it is, the jobs in progress are worth finishing
                    failures.append(error)
                del pending[future]
            if failures:
                for future in [future for future in pending if future.cancel()]:
                    del pending[future]
    if failures:
        raise failures[0]


def _worker_died(jobs: Sequence[str]) -> InputError:
    fix = "Use fewer workers (STEER_WORKERS=1) or repeat the command: finished drives are kept"
    return InputError("a worker process died (out of memory?)", f"at or near {', '.join(jobs)}", fix)


class _Drive:
    """Make one drive's file with its summary beside it; an error names the drive and, where known, the frame."""

    def __init__(self, work: Work) -> None:
        self.work = work

    def __call__(self, job: tuple[str, Path]) -> tuple[Summary, float]:
        drive, path = job
        start = time.perf_counter()
        progress.start()
        try:
            summary = self.work(drive, path)
        except InputError:
            frame = progress.current_frame()
            with error_context(drive if frame is None else f"{drive} frame {frame}"):
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
        stale.unlink(missing_ok=True)


def _sidecar(path: Path) -> Path:
    return path.with_suffix(".json")


def _size(path: Path) -> int:
    return sum(file.stat().st_size for file in path.rglob("*")) if path.is_dir() else path.stat().st_size
