"""One writer per stage folder."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from pipeline.base.atomic import sweep
from pipeline.base.errors import InputError


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
    lock = FileLock(path, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise InputError(
            "another process is writing it", out, "Wait for that to end, then repeat the command"
        ) from None
    except NotImplementedError:  # some network file systems, for instance Lustre without -o flock
        print(f"note: {path.parent} does not support locks: run only one process on {out}", flush=True)
    with lock:
        for folder in (out, pending):
            sweep(folder)
        yield
