"""Replace files and folders in one step, and hold the write lock of a stage folder."""

import errno
import io
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from pipeline.base.errors import InputError

DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # the disk, the user's quota, the limit on one file
_LEFTOVER = re.compile(r"\.(?P<name>.+)\.\w{8}\.tmp")  # mkdtemp's eight characters
_OLD = ".old"
_OTHER_PATH = "Pass another path, or move it away"
# Errors of network file systems without locks, for instance Lustre without -o flock, or NFS without its lock daemon.
_UNSUPPORTED = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a unique temporary path beside `path`, which replaces `path` when the block ends without error.

    The block creates a file or a folder there. A file replaces only a regular file, and a folder only a folder; the
    caller checks that the earlier folder is its own. Anything else at `path` raises InputError and stays.

    The temporary path is ``.NAME.????????.tmp/NAME``, so that two processes that write the same path do not collide,
    the suffix still gives the format, and a glob for ``*.h5`` does not match. An OSError that names the temporary path,
    or a full disk that names none, names `path`.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise InputError("expected a regular file or folder, got a device, pipe or socket", path, _OTHER_PATH)
    path.parent.mkdir(parents=True, exist_ok=True)
    # A folder of its own, as a file from mkstemp is unreadable for other users.
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent))
    tmp = folder / path.name
    try:
        yield tmp
        if path.exists() and tmp.exists() and path.is_dir() != tmp.is_dir():
            expected, got = ("file", "folder") if path.is_dir() else ("folder", "file")
            raise InputError(f"expected a {expected} to replace, got a {got}", path, _OTHER_PATH)
        if path.is_dir() and not path.is_symlink():
            _swap(tmp, path, folder / f"{path.name}{_OLD}")
        else:
            tmp.replace(path)
    except OSError as error:
        name = Path(str(error.filename))
        if error.filename is None and error.errno in DISK_FULL:
            error.filename = str(path)
        elif name.is_relative_to(tmp):
            error.filename, error.filename2 = str(path / name.relative_to(tmp)), None
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def sweep(*folders: Path) -> None:
    """Remove temporary files of killed processes, see :func:`replacing`, directly in `folders`.

    Call it under the lock of the stage, :func:`exclusive`, which sweeps the stage's own folder.
    """
    for path in (path for folder in folders for path in folder.glob(".*.tmp")):
        match = _LEFTOVER.fullmatch(path.name)
        if match and path.is_dir() and not path.is_symlink():
            expected = {match["name"], match["name"] + _OLD}
            if {content.name for content in path.iterdir()} <= expected:
                shutil.rmtree(path, ignore_errors=True)


def _swap(new: Path, path: Path, old: Path) -> None:
    """Replace the folder `path` with `new`. No system call replaces a folder that is not empty."""
    path.replace(old)
    try:
        new.replace(path)
    except OSError:
        old.replace(path)
        raise


def pending_folder(out: Path, *, entry: bool = False) -> Path:
    """Return where finished parts of the stage folder `out` wait for the next run, outside of all DVC outputs.

    ``data/.resume/labels`` for ``data/labels``; of an `entry`, ``data/.resume/train-gnn`` for ``data/train/gnn``.
    """
    if entry:
        return out.parent.with_name(".resume") / f"{out.parent.name}-{out.name}"
    return out.with_name(".resume") / out.name


@contextmanager
def stage_folder(out: Path, *, entry: bool = False) -> Iterator[Path]:
    """Hold the write lock of the stage folder `out`, see :func:`exclusive`, and yield its :func:`pending_folder`.

    Raises InputError if the folder has files that no stage wrote: no earlier run left a lock, and dvc.lock does not
    list the folder.
    """
    pending, dvc_lock = pending_folder(out, entry=entry), Path("dvc.lock")
    visible = [path for path in out.glob("*") if not path.name.startswith(".")]
    if visible and not _lock_of(pending).exists():
        listed = dvc_lock.read_text(encoding="utf-8", errors="replace") if dvc_lock.is_file() else ""
        if not re.search(rf"path: {re.escape(out.as_posix())}(/.*)?$", listed, re.MULTILINE):
            raise InputError("folder has files that no stage wrote", out, "Pass another --out, or move them away")
    with exclusive(out, pending):
        yield pending


def _lock_of(pending: Path) -> Path:
    return pending.with_name(f"{pending.name}.lock")


@contextmanager
def exclusive(out: Path, pending: Path) -> Iterator[None]:
    """Hold the write lock of the stage folder `out`, and remove temporary files of killed runs.

    Args:
        out: where results go, for instance ``data/train/gnn``.
        pending: :func:`pending_folder`; created if missing. The lock is the file ``<pending>.lock``. The system
            releases it when this process dies.

    Raises InputError if another process holds the lock.
    """
    pending.mkdir(parents=True, exist_ok=True)
    path = _lock_of(pending)
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
        sweep(out, pending)
        yield
    finally:
        lock.release()


class Sink(io.FileIO):
    """The file below an HDF5 file. It records the first error and continues.

    HDF5 writes much of a file while closing it, where h5py drops errors: on a full disk, an incomplete file would look
    complete, and the process would crash at its end.
    """

    def __init__(self, tmp: Path, path: Path) -> None:
        """Write to `tmp`; errors name `path`, its final name."""
        super().__init__(tmp, "w+")
        self._path = str(path)
        self._error: OSError | None = None

    def write(self, data: Any) -> int:
        rest = memoryview(data).cast("B")
        size = len(rest)
        try:
            while rest:  # the system may write a part only
                rest = rest[super().write(rest) :]
        except OSError as error:
            self._record(error)
        return size

    def truncate(self, size: int | None = None) -> int:
        try:
            return super().truncate(size)
        except OSError as error:
            self._record(error)
        return size or 0

    def _record(self, error: OSError) -> None:
        error.filename = self._path
        self._error = self._error or error

    def check(self) -> None:
        """Raise the recorded error, if there is one."""
        if self._error:
            raise self._error

    @contextmanager
    def raising(self) -> Iterator[None]:
        """Raise the recorded error at the end of the block, in place of what HDF5 raises as its consequence."""
        try:
            yield
        except Exception as error:
            if self._error and error is not self._error:
                raise self._error from error
            raise
        self.check()
