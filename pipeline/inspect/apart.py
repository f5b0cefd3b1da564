"""Reading in a process of its own: HDF5 runs in circles, or crashes, on some files with flipped bits."""

import multiprocessing
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from pipeline.base.errors import InputError

T = TypeVar("T")
LIMIT_S = (
    5.0  # of CPU time, however busy the machine; a sound file's contents are listed in some hundredths of a second
)
_HINT = "Make it again: dvc repro --force --single-item its stage, or dvc pull"
_reader: "_Reader | None" = None


def apart(read: Callable[..., T], path: Path, *arguments: Any) -> T:
    """Return ``read(path, *arguments)``, picklable, from a process that may hang or crash; it stays for the next call.

    Raises InputError if the process ends, or works longer than :data:`LIMIT_S`; and what `read` raises.
    """
    global _reader
    _reader = _reader or _Reader()
    try:
        good, answer = _reader.answer(read, (path, *arguments))
    except (EOFError, ConnectionError) as error:
        endless = _reader.end() == -signal.SIGPROF
        _reader = None
        how = f"finds no end in it (after {LIMIT_S:.0f} s)" if endless else "crashes on it"
        raise InputError(f"{path} is damaged: the library HDF5 {how}. {_HINT}") from error
    if not good:
        raise answer
    value: T = answer
    return value


class _Reader:
    def __init__(self) -> None:
        # "spawn", as for all workers: see pipeline/base/processes.py. It ends when this end of the pipe does.
        context = multiprocessing.get_context("spawn")
        self._here, there = context.Pipe()
        self._process = context.Process(target=_start, args=(there,), daemon=True)
        self._process.start()
        there.close()

    def answer(self, read: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[bool, Any]:
        self._here.send((read, arguments, LIMIT_S))
        good, answer = self._here.recv()
        return good, answer

    def end(self) -> int | None:
        """Return how the process ended, as a signal below 0."""
        self._process.join()
        self._here.close()
        return self._process.exitcode


def _start(there: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the command, which takes this process with it
    _serve(there)


def _serve(there: Connection) -> None:
    """Answer questions (function, arguments, seconds of CPU time) until nobody asks. SIGPROF ends what takes longer."""
    while True:
        try:
            read, arguments, limit_s = there.recv()
        except EOFError:
            return
        signal.setitimer(signal.ITIMER_PROF, limit_s)
        try:
            answer = True, read(*arguments)
        except Exception as error:
            answer = False, error
        signal.setitimer(signal.ITIMER_PROF, 0)
        there.send(answer)
