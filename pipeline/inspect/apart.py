"""Reading in a process of its own: HDF5 runs in circles, or crashes, on some files with flipped bits."""

import multiprocessing
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from pipeline.base.errors import InputError

T = TypeVar("T")
LIMIT_S = 5.0  # a sound file's contents are listed in some hundredths of a second
_HINT = "Make it again: dvc repro --force its stage, or dvc pull"
_reader: "_Reader | None" = None


def apart(read: Callable[..., T], path: Path, *arguments: Any) -> T:
    """Return ``read(path, *arguments)``, picklable, from a process that may hang or crash; it stays for the next call.

    Raises InputError if the process ends, or has no answer within :data:`LIMIT_S`; and what `read` raises.
    """
    global _reader
    _reader = _reader or _Reader()
    try:
        good, answer = _reader.answer(read, (path, *arguments))
    except (EOFError, ConnectionError, TimeoutError) as error:
        _reader.close()
        _reader = None
        how = (
            f"runs in circles over it (no answer in {LIMIT_S:.0f} s)" if isinstance(error, TimeoutError) else "crashes"
        )
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
        self._here.send(read)
        self._here.recv()  # it has imported it, which on a busy machine takes longer than to read a file
        self._here.send(arguments)
        if not self._here.poll(LIMIT_S):
            raise TimeoutError
        good, answer = self._here.recv()
        return good, answer

    def close(self) -> None:
        self._process.kill()
        self._process.join()
        self._here.close()


def _start(there: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the command, which takes this process with it
    _serve(there)


def _serve(there: Connection) -> None:
    """Answer questions, each a function and then its arguments, until nobody asks."""
    while True:
        try:
            read = there.recv()
            there.send("ready")
            arguments = there.recv()
        except EOFError:
            return
        try:
            answer = True, read(*arguments)
        except Exception as error:
            answer = False, error
        there.send(answer)
