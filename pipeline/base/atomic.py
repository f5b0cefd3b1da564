"""Files and folders that appear under their name when they are complete."""

import errno
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # the disk, the user's quota, the limit on one file
_LEFTOVER = re.compile(r"\.(?P<name>.+)\.\w{8}\.tmp")  # mkdtemp's eight characters
_OLD = ".old"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a unique temporary path beside `path`, which replaces `path` when the block ends without error.

    The block creates a file or a folder there. The temporary path is ``.NAME.????????.tmp/NAME``, so that two processes
    that write the same path do not collide, the suffix still gives the format, and a glob for ``*.h5`` does not match.
    An OSError that names the temporary path, or a full disk that names none, names `path`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # A folder of its own, as a file from mkstemp is unreadable for other users.
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent))
    tmp = folder / path.name
    try:
        yield tmp
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


def sweep(folder: Path) -> None:
    """Remove what killed processes left of :func:`replacing` directly in `folder`.

    Call it under the folder's lock, :func:`pipeline.base.lock.exclusive`.
    """
    for path in folder.glob(".*.tmp"):
        match = _LEFTOVER.fullmatch(path.name)
        if match and path.is_dir() and not path.is_symlink():
            own = {match["name"], match["name"] + _OLD}
            if {content.name for content in path.iterdir()} <= own:
                shutil.rmtree(path, ignore_errors=True)


def _swap(new: Path, path: Path, old: Path) -> None:
    """Replace the folder `path` with `new`. No system call replaces a folder that is not empty."""
    path.replace(old)
    try:
        new.replace(path)
    except OSError:
        old.replace(path)
        raise
