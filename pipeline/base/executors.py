"""Run jobs in this process, in local worker processes, or on the workers of a Dask cluster
(``STEER_SCHEDULER``).
"""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    ProcessPoolExecutor,
    as_completed,
)
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

from pipeline.base.errors import InputError
from pipeline.base.resume import Code

SCHEDULER = "STEER_SCHEDULER"
# A forked child would inherit the thread pools of torch, OpenCV and Open3D in an unusable state.
_SPAWN = multiprocessing.get_context("spawn")
CPU_MAX = Path("/sys/fs/cgroup/cpu.max")  # quota of a container, "200000 100000" for two cores
J = TypeVar("J")


def usable_cores() -> int:
    """Return the number of cores of this process, as SLURM and taskset limit it; macOS and Windows
    have no limits.
    """
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def default_workers() -> int:
    """Return the number of worker processes: ``STEER_WORKERS``, or else the cores that this process
    may use.
    """
    cores = usable_cores()
    if CPU_MAX.is_file() and not (limit := CPU_MAX.read_text()).startswith("max"):
        quota, period = map(int, limit.split())
        cores = max(1, min(cores, quota // period))
    text = os.environ.get("STEER_WORKERS") or str(cores)
    if not text.isdecimal() or not int(text):
        raise InputError(f"expected a number of processes (got {text!r})", "STEER_WORKERS")
    return int(text)


def run_jobs(
    work: Callable[[J], Any],
    jobs: Sequence[J],
    code: Code,
    *,
    workers: int | None = None,
    threads: int | None = None,
) -> Iterator[tuple[J, Any]]:
    """Yield each job with the result of ``work(job)``, picklable, as they finish.

    `workers` are processes, None: :func:`default_workers`; with a Dask cluster, its workers
    instead, unless 1. Each process has `threads` threads; None: the cores are divided, and a single
    job runs in this process. `code`: of `work`, which workers compare with theirs. Raises the first
    error after the jobs in progress are done; no other job is started.
    """
    count = min(workers or default_workers(), len(jobs))
    cluster = os.environ.get(SCHEDULER) if count and workers != 1 else None
    if not cluster and (count == 0 or (count == 1 and threads is None)):
        for job in jobs:
            yield job, work(job)
        return
    threads = threads or max(1, default_workers() // count)
    if cluster:
        work = partial(_call_on_cluster, work, code, str(Path.cwd()))
    else:
        work = partial(_call, work, code)
        os.environ["OMP_NUM_THREADS"] = str(threads)  # read when a worker imports its libraries
    with (
        _cluster(cluster)
        if cluster
        else ProcessPoolExecutor(count, _SPAWN, _start_worker, (threads,)) as pool
    ):
        futures = {pool.submit(work, job): job for job in jobs}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except Exception as error:
            # of Dask
            if (
                isinstance(error, BrokenExecutor | CancelledError)
                or type(error).__name__ == "KilledWorker"
            ):
                fix = (
                    "Use fewer workers (STEER_WORKERS=1) or repeat the command: finished drives "
                    "are kept"
                )
                raise InputError("a worker process died (out of memory?)", fix=fix) from error
            raise
        finally:
            for future in futures:
                future.cancel()


def _start_worker(threads: int) -> None:
    """Limit a worker's threads. The worker ends at Ctrl-C without a traceback, and when its parent
    ends.
    """
    import cv2

    cv2.setNumThreads(threads)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    """Yield the workers of a cluster, which repeats the job of a worker that died up to three
    times.
    """
    from distributed import Client

    try:
        client = Client(address, timeout=5, set_as_default=False)
    except ValueError as error:
        raise InputError(str(error), SCHEDULER) from error
    with client:
        if not client.nthreads():
            print(
                f"waiting for workers. Start them: dask worker {address} --nthreads 1", flush=True
            )
        yield client.get_executor(pure=False)


def _call(work: Callable[[J], Any], code: Code, job: J) -> Any:
    """Call ``work(job)``, whose modules this process has just loaded. Raises InputError if their
    code was edited.
    """
    code.check()
    return work(job)


def _call_on_cluster(work: Callable[[J], Any], code: Code, folder: str, job: J) -> Any:
    """Call ``work(job)`` on a Dask worker, in the caller's folder. Raises InputError if its code
    differs.
    """
    try:
        code.check()
    except InputError as error:
        from distributed import get_worker

        fix = "Update it, and start the worker again from this environment"
        raise InputError(
            f"other code in {error.where}", f"worker {get_worker().address}", fix
        ) from error
    import cv2

    cv2.setNumThreads(1)
    os.chdir(folder)
    return work(job)
