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
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import cache, partial
from importlib.metadata import version
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.base import progress, resume
from pipeline.base.errors import InputError

if TYPE_CHECKING:
    from distributed import Client

SCHEDULER = "STEER_SCHEDULER"
CONNECT_S = 5
# Their versions determine the bytes.
LIBRARIES = ("numpy", "scipy", "torch", "opencv-python-headless", "open3d", "h5py", "hdf5plugin")
Pool = tuple[Executor, Callable[[], int]]
# A forked child would inherit the thread pools of torch, OpenCV and Open3D in an unusable state.
_SPAWN = multiprocessing.get_context("spawn")


class JobKilled(BrokenExecutor):
    """Workers died while they ran this job; other jobs are not affected."""


def default_workers() -> int:
    """Return the number of worker processes: ``STEER_WORKERS``, or else the cores that this process may use."""
    text = os.environ.get("STEER_WORKERS", "")
    if not text:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not text.isdecimal() or int(text) < 1:
        raise InputError(f"expected a number of processes, at least 1 (got {text!r})", "STEER_WORKERS")
    return int(text)


@contextmanager
def executor(workers: int | None, jobs: int, counter: Callable[[int], object], threads: int | None) -> Iterator[Pool]:
    """Yield an executor, and a function that returns how many jobs it can run at once.

    Args:
        workers: processes; None: :func:`default_workers`. With a Dask cluster, its workers instead, unless 1.
        jobs: how many there are; no more processes are started.
        counter: called with numbers of frames as they are done, as :func:`pipeline.base.progress.advance` is called
            in this process and in local workers. On Dask's workers, frames count when their job is done.
        threads: of each process, also if there is only one; None: the cores are divided among the processes.
    """
    if workers is not None and workers < 1:
        raise InputError(f"expected at least 1 process (got {workers})", "--workers")
    count = min(workers or default_workers(), jobs)

    def capacity() -> int:
        return count

    if workers != 1 and (address := os.environ.get(SCHEDULER)):
        with _dask(address, counter) as cluster:
            yield cluster, cluster.capacity
    elif count == 1 and threads is None:
        progress.report_to(counter)
        try:
            yield SerialExecutor(), capacity
        finally:
            progress.report_to(None)
    else:
        with _processes(count, threads or max(1, default_workers() // count), counter) as pool:
            yield pool, capacity


class SerialExecutor(Executor):
    """Run each call at once in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def _processes(workers: int, threads: int, counter: Callable[[int], object]) -> Iterator[Executor]:
    frames = _SPAWN.Value("q", 0)
    stop = threading.Event()
    watcher = threading.Thread(target=_forward, args=(frames, counter, stop), daemon=True)
    watcher.start()
    try:
        with _Processes(workers, threads, frames) as pool:
            try:
                yield pool
            except BaseException:  # for instance Ctrl-C; else the pool waits for the jobs in progress
                for child in multiprocessing.active_children():
                    child.terminate()
                raise
    finally:
        stop.set()
        watcher.join()


class _Processes(ProcessPoolExecutor):
    """Worker processes, started as calls are submitted, with OMP_NUM_THREADS set and Ctrl-C left to this process."""

    def __init__(self, workers: int, threads: int, frames: "Synchronized[int]") -> None:
        super().__init__(workers, _SPAWN, _start_worker, (threads, frames))
        self._threads = threads

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        old_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # children inherit it
        old_threads = os.environ.get("OMP_NUM_THREADS")
        os.environ["OMP_NUM_THREADS"] = str(self._threads)  # read when a child imports its libraries
        try:
            return super().submit(fn, *args, **kwargs)
        finally:
            if old_threads is None:
                del os.environ["OMP_NUM_THREADS"]
            else:
                os.environ["OMP_NUM_THREADS"] = old_threads
            signal.pthread_sigmask(signal.SIG_SETMASK, old_mask)


def _forward(frames: "Synchronized[int]", counter: Callable[[int], object], stop: threading.Event) -> None:
    """Call `counter` with the frames that workers have counted since the last time, twice a second."""
    done = 0
    while not stop.wait(0.5):
        new = frames.value
        counter(new - done)
        done = new
    counter(frames.value - done)


def _start_worker(threads: int, frames: "Synchronized[int]") -> None:
    """Limit a worker's threads, and end it when its parent ends."""
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    progress.report_to_counter(frames)
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
def _dask(address: str, counter: Callable[[int], object]) -> Iterator["_DaskExecutor"]:
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
        problem = f"no scheduler answers ({error})"
        fix = "Start one: dask scheduler. Or unset the variable"
        raise InputError(problem, f"{SCHEDULER}={address}", fix) from error
    with client:
        cluster = _DaskExecutor(client, address, counter)
        if not client.nthreads():
            print(f"waiting for workers of {address}. {cluster.fix}", flush=True)
            client.wait_for_workers(1)
        yield cluster


class _DaskExecutor(Executor):
    """Run calls on Dask's workers, in the folder and with the code of this process.

    Dask gives the job of a worker that died to another worker, three times.
    """

    def __init__(self, client: "Client", address: str, counter: Callable[[int], object]) -> None:
        self._client, self._address, self._counter = client, address, counter
        self._executor = client.get_executor(pure=False)
        self.fix = f"Start workers in this environment: dask worker {address} --nthreads 1"

    def capacity(self) -> int:
        """Return the number of workers; they may come and go."""
        try:
            return max(1, len(self._client.nthreads()))
        except OSError as error:
            raise self._scheduler_lost() from error

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        from distributed.protocol.pickle import dumps

        # Unlike pickle.dumps, this takes functions of ``python -m stages.NAME``. The scheduler does not load bytes.
        call = dumps(partial(fn, *args, **kwargs))
        outer: Future[Any] = Future()
        inner = self._executor.submit(_call_on_worker, call, str(Path.cwd()), _environment(), self.fix)
        inner.add_done_callback(partial(self._finish, outer))
        return outer

    def _finish(self, outer: Future[Any], inner: Future[Any]) -> None:
        from distributed import KilledWorker

        try:
            result, frames = inner.result()
        except CancelledError:
            outer.set_exception(self._scheduler_lost())
        except KilledWorker as error:
            died = f"{error.allowed_failures + 1} workers died (out of memory?), the last one {error.last_worker}"
            outer.set_exception(JobKilled(died))
        except Exception as error:
            outer.set_exception(error)
        else:
            self._counter(frames)
            outer.set_result(result)

    def _scheduler_lost(self) -> InputError:
        fix = "Start it again, then repeat the command: finished drives are kept"
        return InputError("lost the connection to the scheduler", f"{SCHEDULER}={self._address}", fix)


@cache
def _environment() -> dict[str, str]:
    """Return what determines the bytes that a process writes, as it was when this process first asked."""
    versions = {name: version(name) for name in LIBRARIES}
    return {"Python": platform.python_version(), **versions, "code of the project": resume.code_hash()}


def _call_on_worker(call: bytes, folder: str, environment: dict[str, str], fix: str) -> tuple[Any, int]:
    """Call a pickled function on a Dask worker; return its result and the frames that it counted.

    Raises InputError if the worker's code, libraries, files or threads differ from the caller's.
    """
    from distributed import get_worker

    worker = get_worker()
    where = f"worker {worker.address}"
    if worker.state.nthreads != 1:
        raise InputError(f"expected one thread, got {worker.state.nthreads}", where, fix)
    try:
        os.chdir(folder)
    except OSError as error:
        problem = f"cannot enter {folder} ({error.strerror}): workers must share this machine's file system"
        raise InputError(problem, where, "See docs/cluster.md") from error
    for name, expected in environment.items():
        if (got := _environment()[name]) != expected:
            problem = f"{name} differs (got {got[:12]} in {resume.ROOT}, expected {expected[:12]})"
            raise InputError(problem, where, f"Stop the worker. {fix}")
    _limit_threads(1)
    frames: list[int] = []
    progress.report_to(frames.append)
    try:
        return pickle.loads(call)(), sum(frames)
    finally:
        progress.report_to(None)
