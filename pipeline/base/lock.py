"""One writer per stage folder."""

import errno
import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from pipeline.base.atomic import sweep
from pipeline.base.errors import InputError

_UNSUPPORTED = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK)  # some network file systems, as Lustre without -o flock


@contextmanager
def held(folder: Path, kept: Path) -> Iterator[Path]:
    """Be the only process that writes the stage folder `folder`, as long as the block lasts.

    Args:
        folder: where results end up, for instance ``data/train/gnn``.
        kept: where finished parts wait for the next run, for instance ``data/.resume/train-gnn``; made if absent. The
            lock is the file ``<kept>.lock``, outside of what DVC tracks. The system releases it when this process dies.

    Yields the lock's file, which says who holds it.

    What killed runs left half-written in either folder is removed.

    Raises InputError if another process holds it.
    """
    kept.mkdir(parents=True, exist_ok=True)
    path = kept.with_name(f"{kept.name}.lock")
    file = _lock(path, folder)
    try:
        for place in (folder, kept):
            sweep(place)
        yield path
    finally:
        path.unlink(missing_ok=True)  # before it is released: see _lock
        file.close()


def _lock(path: Path, folder: Path) -> TextIO:
    """Return the open file, locked. It holds this process's id and machine, for the message to others."""
    while True:
        file = path.open("a+", encoding="utf-8")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            holder = file.read().split()
            file.close()
            raise InputError(_refusal(folder, holder)) from None
        except OSError as error:
            if error.errno not in _UNSUPPORTED:
                file.close()
                raise
            print(
                f"note: {path.parent} cannot be locked ({error.strerror}): run one process only on {folder}", flush=True
            )
        if _is_current(file, path):
            _sign(file, path)
            return file
        file.close()  # its holder removed it between open and flock


def _sign(file: TextIO, path: Path) -> None:
    """Say whose the lock is. Raises OSError, naming `path`, on a full disk; the lock is free then."""
    try:
        file.truncate(0)
        os.write(file.fileno(), f"{os.getpid()} {socket.gethostname()}\n".encode())
    except OSError as error:
        file.close()
        error.filename = str(path)
        raise


def _is_current(file: TextIO, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


def _refusal(folder: Path, holder: list[str]) -> str:
    if len(holder) != 2:  # locked, but its id is not written yet
        return f"{folder} is being written by another process: wait for it to end and run the same command again"
    process, machine = holder
    where = "" if machine == socket.gethostname() else f" on {machine}"
    return f"{folder} is being written by process {process}{where}: wait for it to end, or end it: kill {process}"
