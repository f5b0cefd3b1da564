"""Executors: this process, local worker processes, or the workers of a Dask cluster (``STEER_SCHEDULER``)."""

import multiprocessing
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

from pipeline.base import progress, resume
from pipeline.base.errors import InputError

SCHEDULER = "STEER_SCHEDULER"
CONNECT_S = 5
LIBRARIES = ["numpy", "scipy", "torch", "cv2", "open3d", "h5py", "hdf5plugin"]  # their versions determine the bytes


def default_workers() -> int:
    """Return the number of worker processes: ``STEER_WORKERS``, or else the cores that this process may use."""
    text = os.environ.get("STEER_WORKERS", "")
    if not text:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not text.isdecimal() or int(text) < 1:
        raise InputError(f"expected a number of processes, at least 1 (got {text!r})", "STEER_WORKERS")
    return int(text)


@contextmanager
def executor(workers: int, counter: Callable[[int], object], threads: int | None = None) -> Iterator[Executor]:
    """Yield an executor with `workers` processes of `threads` each, or with those of a Dask cluster.

    `counter` is called with numbers of frames as they are done: as :func:`pipeline.base.progress.advance` is called
    in this process and in local workers. Dask's workers do not report.
    """
    if address := os.environ.get(SCHEDULER):
        with _dask(address) as cluster:
            yield cluster
    elif workers <= 1:
        progress.report_to(counter)
        try:
            yield SerialExecutor()
        finally:
            progress.report_to(None)
    else:
        with _processes(workers, threads or max(1, default_workers() // workers), counter) as pool:
            yield pool


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
    # "spawn": a forked child would inherit the thread pools of torch, OpenCV and Open3D in an unusable state.
    context = multiprocessing.get_context("spawn")
    frames = context.Value("q", 0)
    environment = dict(os.environ)
    os.environ["OMP_NUM_THREADS"] = str(threads)  # read when a child imports its libraries
    stop = threading.Event()
    watcher = threading.Thread(target=_forward, args=(frames, counter, stop), daemon=True)
    watcher.start()
    try:
        with ProcessPoolExecutor(workers, context, _start_worker, (threads, frames)) as pool:
            try:
                yield pool
            except KeyboardInterrupt:
                for child in multiprocessing.active_children():  # else the pool waits for the drives in progress
                    child.terminate()
                raise
    finally:
        stop.set()
        watcher.join()
        os.environ.clear()
        os.environ.update(environment)


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
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # ignored in a shell's background job
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C: end without a traceback from each worker
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
def _dask(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client
        from distributed.comm.addressing import parse_address, parse_host_port
    except ModuleNotFoundError as error:
        raise InputError(str(error), SCHEDULER, "Install it: pip install '.[cluster]'") from error
    fix = f"Start workers in this environment: dask worker {address} --nthreads 1"
    try:
        host_port = parse_host_port(parse_address(address, strict=True)[1])
        socket.create_connection(host_port, CONNECT_S).close()  # fails in one line, a Client in many
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        problem = f"no scheduler answers ({error})"
        raise InputError(
            problem, f"{SCHEDULER}={address}", "Start one: dask scheduler. Or unset the variable"
        ) from error
    with client:
        if not client.nthreads():
            print(f"waiting for workers of {address}. {fix}", flush=True)
        client.wait_for_workers(1)
        try:
            client.get_versions(check=True, packages=LIBRARIES)
        except ValueError as error:
            raise InputError(f"workers have other versions ({' '.join(str(error).split())})", address, fix) from error
        yield _DaskExecutor(client.get_executor(pure=False), fix)


class _DaskExecutor(Executor):
    """Run calls on Dask's workers, in the folder and with the code of this process."""

    def __init__(self, inner: Executor, fix: str) -> None:
        self._inner, self._fix = inner, fix

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        call = (fn, args, kwargs)
        return self._inner.submit(_call_on_worker, call, str(Path.cwd()), resume.code_hash(), self._fix)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._inner.shutdown(wait=wait, cancel_futures=cancel_futures)


def _call_on_worker(call: Any, folder: str, code: str, fix: str) -> Any:
    """Call a function on a Dask worker. Raises InputError if the worker's code, files or threads differ."""
    from distributed import get_worker

    worker = get_worker()
    if worker.state.nthreads != 1:
        raise InputError(f"expected one thread, got {worker.state.nthreads}", f"worker {worker.address}", fix)
    try:
        os.chdir(folder)
    except OSError as error:
        problem = f"cannot enter {folder} ({error.strerror}): workers must share this machine's file system"
        raise InputError(problem, f"worker {worker.address}", "See docs/cluster.md") from error
    if resume.code_hash() != code:
        problem = f"runs other code, in {resume.ROOT}, or did before an edit"
        raise InputError(problem, f"worker {worker.address}", f"Stop it. {fix}")
    _limit_threads(1)
    function, args, kwargs = call
    return function(*args, **kwargs)
