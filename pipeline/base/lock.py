"""One writer per stage folder."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from pipeline.base.atomic import sweep
from pipeline.base.errors import InputError

# Of network file systems, for instance Lustre without -o flock, or NFS without its lock daemon.
_UNSUPPORTED = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK)


@contextmanager
def exclusive(out: Path, pending: Path) -> Iterator[None]:
    """Hold the write lock of the stage folder `out`, and remove what killed runs left half-written.

    Args:
        out: where results go, for instance ``data/train/gnn``.
        pending: where finished parts wait for the next run, for instance ``data/.resume/train-gnn``; created if
            missing. The lock is the file ``<pending>.lock``, outside of what DVC tracks. The system releases it when
            this process dies.

    Raises InputError if another process holds the lock.
    """
    pending.mkdir(parents=True, exist_ok=True)
    path = pending.with_name(f"{pending.name}.lock")
    if path.is_symlink():
        raise InputError("expected a regular file, got a symbolic link", path, f"Remove it: rm {path}")
    lock = FileLock(path, timeout=0, fallback_to_soft=False)
    try:
        lock.acquire()
    except Timeout:
        problem, fix = "another process is writing it", "Wait for that to end, then repeat the command"
        raise InputError(problem, out, fix) from None
    except OSError as error:
        if error.errno not in _UNSUPPORTED:
            raise
        print(f"note: {path.parent} does not support locks: run only one process on {out}", flush=True)
    try:
        for folder in (out, pending):
            sweep(folder)
        yield
    finally:
        lock.release()
