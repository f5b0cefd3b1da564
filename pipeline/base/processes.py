"""Worker processes that use as many threads as they are given, tell how far they are, and end with this process."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.sharedctypes import Synchronized
from typing import Any

from pipeline.base import progress
from pipeline.base.errors import InputError
from pipeline.base.jobs import Job

BROKEN = (
    "a worker process died (out of memory?) at or near {where}: use fewer workers (STEER_WORKERS=1) "
    "or run the command again; what is finished is kept"
)
_work: Any = None


@dataclass(frozen=True)
class Processes:
    """The :class:`pipeline.base.jobs.Workers` of this machine."""

    count: int
    pool: ProcessPoolExecutor
    counter: "Synchronized[int]"

    @property
    def done_frames(self) -> int:
        return self.counter.value

    def submit(self, job: Job) -> Future[Any]:
        try:
            return self.pool.submit(_with_work, job.call)
        except BrokenProcessPool as error:  # just now, before any job says so
            raise InputError(BROKEN.format(where=job.where)) from error

    def result(self, future: Future[Any], where: str) -> Any:
        try:
            return future.result()
        except BrokenProcessPool as error:
            raise InputError(BROKEN.format(where=where)) from error


@contextmanager
def processes(workers: int, threads: int, work: Any) -> Iterator[Processes]:
    """Yield worker processes whose libraries use so many threads. Each has `work`, picklable, as long as it lives."""
    # "spawn": a forked child would inherit the thread pools of torch, OpenCV and Open3D in an unusable state.
    context = multiprocessing.get_context("spawn")
    done_frames = context.Value("q", 0)
    with _Environment(OMP_NUM_THREADS=str(threads)), ProcessPoolExecutor(
        workers, mp_context=context, initializer=_start_worker, initargs=(threads, done_frames, work)
    ) as pool:  # fmt: skip
        yield Processes(workers, pool, done_frames)


def _with_work(call: Callable[[Any], Any]) -> Any:
    return call(_work)


def _start_worker(threads: int, done_frames: "Synchronized[int]", work: Any) -> None:
    """Keep a worker's libraries from using every core each, and the worker from outliving a killed stage."""
    import cv2

    global _work
    _work = work
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # as in a shell's background job, which goes on
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C: end without a traceback each
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    cv2.setNumThreads(threads)
    progress.listen_with(done_frames)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(threads)


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


class _Environment:
    """Environment variables for the children started inside the block."""

    def __init__(self, **variables: str) -> None:
        self._new = variables

    def __enter__(self) -> None:
        self._old = {name: os.environ.get(name) for name in self._new}
        os.environ.update(self._new)

    def __exit__(self, *_: object) -> None:
        for name, value in self._old.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
