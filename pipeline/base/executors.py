"""Run jobs in this process or in worker processes."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

from pipeline.base.errors import InputError
from pipeline.base.resume import Code

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
    code: Code,
    *,
    workers: int | None = None,
    threads: int | None = None,
) -> Iterator[tuple[J, Any]]:
    """Yield each job with the result of ``work(job)``, in the order in which jobs finish.

    Jobs and results are picklable. `workers` is the number of processes; if it is None,
    :func:`default_workers` is. Each process has `threads` threads. If `threads` is None, the cores
    are divided among the processes, and a single process is this one. `code` is the code of `work`:
    each worker checks that it has loaded the same.

    If a job raises an exception, no further job is started, and the exception is raised after the
    jobs in progress are done.
    """
    if not jobs:
        return
    count = min(workers or default_workers(), len(jobs))
    if count == 1 and threads is None:
        for job in jobs:
            yield job, work(job)
        return

    threads = threads or max(1, default_workers() // count)
    os.environ["OMP_NUM_THREADS"] = str(threads)  # read when a worker imports its libraries
    with ProcessPoolExecutor(count, _SPAWN, _start_worker, (threads,)) as executor:
        call = partial(_call, work, code)
        futures = {executor.submit(call, job): job for job in jobs}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except (BrokenExecutor, CancelledError) as error:
            repeat = "repeat the command: finished drives are kept"
            fix = f"Use fewer workers ({WORKERS}=1) or {repeat}"
            raise InputError("a worker process died (out of memory?)", fix=fix) from error
        finally:
            for future in futures:
                future.cancel()


def _start_worker(threads: int) -> None:
    """Limit a worker's threads, and let it end with its parent.

    At Ctrl-C it ends without a traceback.
    """
    import cv2

    cv2.setNumThreads(threads)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    """Wait for the parent process to end, then end this process."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _call(work: Callable[[J], Any], code: Code, job: J) -> Any:
    """Call ``work(job)`` in a worker process. Raises InputError if it has other code."""
    code.check_worker()
    return work(job)
