"""Executors: this process, local worker processes, or the workers of a Dask cluster (``STEER_SCHEDULER``)."""

import logging
import multiprocessing
import os
import pickle
import platform
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pipeline.base import resume
from pipeline.base.errors import InputError

if TYPE_CHECKING:
    from distributed import Client

SCHEDULER = "STEER_SCHEDULER"
CONNECT_S = 5
_DIGITS = 4  # of STEER_WORKERS
# Packages whose versions determine the bytes of artefacts.
LIBRARIES = ("numpy", "scipy", "torch", "opencv-python-headless", "open3d", "h5py", "hdf5plugin")
# A forked child would inherit the thread pools of torch, OpenCV and Open3D in an unusable state.
_SPAWN = multiprocessing.get_context("spawn")


class Pool(NamedTuple):
    """An executor, and a function that returns how many jobs it can run at once."""

    executor: Executor
    capacity: Callable[[], int]


def default_workers() -> int:
    """Return the number of worker processes: ``STEER_WORKERS``, or else the cores that this process may use."""
    text = os.environ.get("STEER_WORKERS", "")
    if not text:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not (text.isdecimal() and len(text) <= _DIGITS and int(text)):
        got = text if len(text) <= 80 else f"{text[:80]}…"
        raise InputError(f"expected a number of processes, 1 to {10**_DIGITS - 1} (got {got!r})", "STEER_WORKERS")
    return int(text)


@contextmanager
def executor(workers: int | None, jobs: int, threads: int | None) -> Iterator[Pool]:
    """Yield an executor.

    Args:
        workers: processes; None: :func:`default_workers`. With a Dask cluster, its workers instead, unless 1.
        jobs: how many there are; no more processes are started.
        threads: of each process, also if there is only one; None: the cores are divided among the processes.
    """
    if workers is not None and workers < 1:
        raise InputError(f"expected at least 1 process (got {workers})", "--workers")
    count = min(workers or default_workers(), jobs)
    if workers != 1 and (address := os.environ.get(SCHEDULER)):
        with _dask(address) as pool:
            yield pool
    elif count == 1 and threads is None:
        yield Pool(SerialExecutor(), lambda: 1)
    else:
        with _Processes(count, threads or max(1, default_workers() // count)) as processes:
            yield Pool(processes, lambda: count)


class SerialExecutor(Executor):
    """Run each call at once in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class _Processes(ProcessPoolExecutor):
    """Worker processes, started as calls are submitted, with OMP_NUM_THREADS set and Ctrl-C left to this process."""

    def __init__(self, workers: int, threads: int) -> None:
        super().__init__(workers, _SPAWN, _start_worker, (threads,))
        self._threads = threads

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        old_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # children inherit it
        old_threads = os.environ.get("OMP_NUM_THREADS")
        os.environ["OMP_NUM_THREADS"] = str(self._threads)  # read when a child imports its libraries
        try:
            return super().submit(fn, *args, **kwargs)
        finally:
            os.environ.pop("OMP_NUM_THREADS")
            os.environ |= {} if old_threads is None else {"OMP_NUM_THREADS": old_threads}
            signal.pthread_sigmask(signal.SIG_SETMASK, old_mask)

    def __exit__(self, kind: type[BaseException] | None, *error: Any) -> bool | None:
        if kind:  # for instance Ctrl-C; else the pool waits for the jobs in progress
            for child in multiprocessing.active_children():
                child.terminate()
        return super().__exit__(kind, *error)


def _start_worker(threads: int) -> None:
    """Limit a worker's threads, and end it when its parent ends."""
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
def _dask(address: str) -> Iterator[Pool]:
    where, fix = f"{SCHEDULER}={address}", "Start one: dask scheduler. Or unset the variable"
    try:
        from distributed import Client
        from distributed.comm.addressing import parse_address, parse_host_port
    except ModuleNotFoundError as error:
        raise InputError(str(error), SCHEDULER, "Install it: pip install '.[cluster]'") from error
    for name in ("distributed.client", "tornado.application"):  # errors here are one line
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        host_port = parse_host_port(parse_address(address, strict=True)[1])
        socket.create_connection(host_port, CONNECT_S).close()  # fails in one line, a Client in many
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"no scheduler answers ({error})", where, fix) from error
    with client:
        if not client.nthreads():
            print(f"waiting for workers. Start them: dask worker {address} --nthreads 1", flush=True)
        try:
            client.wait_for_workers(1)
            yield Pool(_Cluster(client), lambda: max(1, len(client.nthreads())))
        except (CancelledError, OSError) as error:
            if client.status == "running":
                raise
            fix = "Start it again, then repeat the command: finished drives are kept"
            raise InputError("lost the connection to the scheduler", where, fix) from error


class _Cluster(Executor):
    """Run calls on Dask's workers, which repeat the call of a worker that died up to three times."""

    def __init__(self, client: "Client") -> None:
        self._executor = client.get_executor(pure=False)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        from distributed.protocol.pickle import dumps

        # Unlike pickle.dumps, this takes functions of ``python -m stages.NAME``. The scheduler does not load bytes.
        call = dumps(partial(fn, *args, **kwargs))
        future: Future[Any] = self._executor.submit(_call_on_worker, call, str(Path.cwd()), _environment())
        return future


@cache
def _environment() -> dict[str, str]:
    """Return the versions of Python, libraries and code, which determine all bytes, cached at the first call."""
    versions = {name: version(name) for name in LIBRARIES}
    return {"Python": platform.python_version(), **versions, "code of the project": resume.code_hash()}


def _call_on_worker(call: bytes, folder: str, environment: dict[str, str]) -> Any:
    """Call a pickled function on a Dask worker, in the caller's folder, and return its result.

    Raises InputError if the worker's threads, code or libraries differ.
    """
    from distributed import get_worker

    threads = str(get_worker().state.nthreads)
    for name, expected in {"threads": "1", **environment}.items():
        if (got := {"threads": threads, **_environment()}[name]) != expected:
            problem = f"{name}: got {got[:12]} in {resume.ROOT}, expected {expected[:12]}"
            fix = "Start the worker again from this environment with --nthreads 1"
            raise InputError(problem, f"worker {get_worker().address}", fix)
    os.chdir(folder)
    _limit_threads(1)
    return pickle.loads(call)()
