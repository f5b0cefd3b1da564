"""Where jobs run: this process, local worker processes, or the workers of a Dask cluster (``STEER_SCHEDULER``)."""

import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pipeline.base import resume
from pipeline.base.errors import InputError

SCHEDULER = "STEER_SCHEDULER"
CONNECT_S = 5
# A forked child would inherit the thread pools of torch, OpenCV and Open3D in an unusable state.
_SPAWN = multiprocessing.get_context("spawn")
Submit = Callable[[Callable[[Any], Any], Any], "Future[Any]"]


def default_workers() -> int:
    """Return the number of worker processes: ``STEER_WORKERS``, or else the cores that this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    text = os.environ.get("STEER_WORKERS") or str(cores)
    if not text.isdecimal() or not int(text):
        raise InputError(f"expected a number of processes (got {text!r})", "STEER_WORKERS")
    return int(text)


@contextmanager
def executor(workers: int | None, jobs: int, threads: int | None) -> Iterator[Submit | None]:
    """Yield a function that submits ``function(argument)`` and returns a future; None: call it in this process.

    Args:
        workers: processes; None: :func:`default_workers`. With a Dask cluster, its workers instead, unless 1.
        jobs: how many there are; no more processes are started.
        threads: of each process, also if there is only one; None: the cores are divided among the processes.
    """
    count = min(workers or default_workers(), jobs)
    if jobs and workers != 1 and (address := os.environ.get(SCHEDULER)):
        with _dask(address) as submit:
            yield submit
    elif count == 0 or (count == 1 and threads is None):
        yield None
    else:
        with _processes(count, threads or max(1, default_workers() // count)) as submit:
            yield submit


@contextmanager
def _processes(count: int, threads: int) -> Iterator[Submit]:
    os.environ["OMP_NUM_THREADS"] = str(threads)  # read when a worker imports its libraries
    pool = ProcessPoolExecutor(count, _SPAWN, _start_worker, (threads,))
    try:
        yield pool.submit
    except BaseException:  # for instance Ctrl-C; otherwise the pool waits for the jobs in progress
        for worker in multiprocessing.active_children():
            worker.terminate()
        raise
    finally:
        pool.shutdown()


def _start_worker(threads: int) -> None:
    """Limit a worker's threads, leave Ctrl-C to its parent, and end it when its parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    _limit_threads(threads)


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _limit_threads(threads: int) -> None:
    import cv2

    cv2.setNumThreads(threads)
    if "torch" in sys.modules:  # else it reads OMP_NUM_THREADS
        sys.modules["torch"].set_num_threads(threads)


@contextmanager
def _dask(address: str) -> Iterator[Submit]:
    """Yield the function that submits to a cluster, which repeats the call of a worker that died up to three times."""
    from distributed import Client
    from distributed.protocol.pickle import dumps

    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        fix = "Start one: dask scheduler. Or unset the variable"
        raise InputError(f"no scheduler answers ({error})", f"{SCHEDULER}={address}", fix) from error
    with client:
        if not client.nthreads():
            print(f"waiting for workers. Start them: dask worker {address} --nthreads 1", flush=True)
        client.wait_for_workers(1)
        pool = client.get_executor(pure=False)

        def submit(function: Callable[[Any], Any], argument: Any) -> "Future[Any]":
            # Bytes, so that a worker with other code can refuse before it loads them. Unlike pickle.dumps, this takes
            # functions of ``python -m stages.NAME``.
            call = dumps((function, argument))
            future: Future[Any] = pool.submit(_call_on_worker, call, str(Path.cwd()), resume.code_hash())
            return future

        yield submit


def _call_on_worker(call: bytes, folder: str, code: str) -> Any:
    """Call a pickled function on a Dask worker, in the caller's folder. Raises InputError if the worker's code differs.

    `code`: :func:`pipeline.base.resume.code_hash` of the caller.
    """
    if resume.code_hash() != code:
        from distributed import get_worker

        problem, fix = f"other code in {resume.ROOT}", "Update it, and start the worker again from this environment"
        raise InputError(problem, f"worker {get_worker().address}", fix)
    os.chdir(folder)
    _limit_threads(1)
    function, argument = pickle.loads(call)
    return function(argument)
