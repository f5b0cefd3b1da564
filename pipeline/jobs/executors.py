"""Run jobs in this process, in worker processes, or on the workers of a Dask cluster."""

import multiprocessing
import os
import signal
import socket
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

from pipeline.jobs.keys import LOADED, scan_code
from pipeline.jobs.outputs import StageFolder

from pipeline.base.errors import InputError

# Environment variable with the address of a Dask scheduler.
SCHEDULER = "STEER_SCHEDULER"
# Environment variable with the number of worker processes.
WORKERS = "STEER_WORKERS"
# File with the CPU quota of a container: CPU time and period in microseconds, "200000 100000" for
# two cores.
CPU_MAX = Path("/sys/fs/cgroup/cpu.max")
# A forked child would inherit the thread pools of torch, OpenCV and Open3D in an unusable state.
_SPAWN = multiprocessing.get_context("spawn")
J = TypeVar("J")


def usable_cores() -> int:
    """Return the number of cores that this process may use, as SLURM and taskset limit it."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    # macOS and Windows do not limit a process to some cores.
    return os.cpu_count() or 1


def default_workers() -> int:
    """Return the number of worker processes: ``STEER_WORKERS``, or one per core."""
    text = os.environ.get(WORKERS)
    if not text:
        return _cores_of_container()
    if not text.isdecimal() or not int(text):
        raise InputError(f"expected a number of processes (got {text!r})", WORKERS)
    return int(text)


def _cores_of_container() -> int:
    """Return the number of usable cores, within the quota of the container, if there is one."""
    cores = usable_cores()
    if not CPU_MAX.is_file():
        return cores
    quota, period = CPU_MAX.read_text().split()
    if quota == "max":
        return cores
    return max(1, min(cores, int(quota) // int(period)))


def run_jobs(
    work: Callable[[J], Any],
    jobs: Sequence[J],
    folder: StageFolder,
    *,
    workers: int | None = None,
    threads: int | None = None,
) -> Iterator[tuple[J, Any]]:
    """Yield each job with the result of ``work(job)``, in the order in which jobs finish.

    Jobs and results are picklable. `workers` is the number of processes; if it is None,
    :func:`default_workers` is. A single process is this one. Each process has `threads` threads; if
    `threads` is None, the cores are divided among the processes. If ``STEER_SCHEDULER`` names a
    Dask cluster, its workers are taken instead, with a thread each, unless `workers` is 1. Each
    worker checks that it has the code and the `folder` of the stage.

    If a job raises an exception, no further job is started, and the exception is raised. Before
    that, local processes end their jobs in progress; a cluster ends them later.
    """
    if not jobs:
        return
    on_cluster = SCHEDULER in os.environ and workers != 1
    count = min(workers or default_workers(), len(jobs))
    if count == 1 and not on_cluster:
        for job in jobs:
            yield job, work(job)
        return

    threads = threads or max(1, default_workers() // count)
    call = partial(_call_in_worker, work, folder, 1 if on_cluster else threads, on_cluster)
    try:
        with _open_executor(count, threads) as executor:
            futures = {executor.submit(call, job): job for job in jobs}
            for future in as_completed(futures):
                yield futures[future], future.result()
    except (BrokenExecutor, CancelledError) as error:
        # After an edit, a process may fail to load the work.
        folder.code.check_unedited(scan_code())
        fix = f"Use fewer workers ({WORKERS}=1) or repeat the command: finished drives are kept"
        raise InputError("a worker process died (out of memory?)", fix=fix) from error


@contextmanager
def _open_executor(count: int, threads: int) -> Iterator[Executor]:
    """Yield `count` processes of this machine, or the workers of a Dask cluster.

    At the end, jobs that have not started are cancelled.
    """
    address = os.environ.get(SCHEDULER)
    if not address:
        os.environ["OMP_NUM_THREADS"] = str(threads)  # read when a worker imports its libraries
        processes = ProcessPoolExecutor(count, _SPAWN, _start_worker)
        try:
            yield processes
        finally:
            processes.shutdown(cancel_futures=True)
        return

    try:
        from distributed import Client, KilledWorker

        client = Client(address, timeout=10, set_as_default=False)
    except (ImportError, OSError, ValueError) as error:
        problem = f"no scheduler answers at {address} ({error})"
        fix = "Start one: dask scheduler. Or install Dask: pip install '.[cluster]'"
        raise InputError(problem, SCHEDULER, fix) from error
    with client:
        if not client.nthreads():
            print(f"waiting for workers. Start one: dask worker {address} --nthreads 1", flush=True)
        cluster = client.get_executor(pure=False, retries=0)
        try:
            yield cluster
        except KilledWorker as error:
            raise BrokenExecutor from error
        finally:
            cluster.shutdown(wait=False)


def _start_worker() -> None:
    """Let a worker end with its parent. At Ctrl-C it ends without a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    """Wait for the parent process to end, then end this process."""
    parent = multiprocessing.parent_process()
    assert parent is not None, "called in a worker process only"
    parent.join()
    os._exit(1)


def _call_in_worker(
    work: Callable[[J], Any], folder: StageFolder, threads: int, on_cluster: bool, job: J
) -> Any:
    """Call ``work(job)`` in a worker. Raises InputError if it has other code, or other data."""
    import cv2

    if on_cluster:
        folder.code.check_worker()
    else:
        # This process has loaded the code after the stage.
        folder.code.check_unedited(LOADED)
    if not folder.new.is_dir():
        where = f"{folder.new.parent} of the worker on {socket.gethostname()}"
        fix = "Start the worker in a folder whose data is the same as here"
        raise InputError("is not the folder of the stage", where, fix)
    cv2.setNumThreads(threads)
    return work(job)
