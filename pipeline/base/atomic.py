"""Files and folders that appear under their name only when they are complete."""

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
    """Yield a unique temporary path beside `path`, which takes its place when the block ends well and goes otherwise.

    The block makes a file or a folder there. Two processes that write the same path do not meet: the temporary path is
    ``.NAME.????????.tmp/NAME``, so that its suffix still tells writers the format, and a glob for ``*.h5`` beside
    `path` never meets it. An OSError that names the temporary path, or a full disk that names none, names `path`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # A folder of its own, and not a file from mkstemp, which nobody else may read.
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
    """Remove what killed processes left of :func:`replacing` directly in `folder`, and nothing else.

    Only for who knows that nobody writes there: :func:`pipeline.base.lock.held`.
    """
    for path in folder.glob(".*.tmp"):
        match = _LEFTOVER.fullmatch(path.name)
        if match and path.is_dir() and not path.is_symlink():
            own = {match["name"], match["name"] + _OLD}
            if {content.name for content in path.iterdir()} <= own:
                shutil.rmtree(path, ignore_errors=True)


def _swap(new: Path, path: Path, old: Path) -> None:
    """Put `new` in the place of the folder `path`, which no system call does in one step for one that is not empty."""
    path.replace(old)
    try:
        new.replace(path)
    except OSError:
        old.replace(path)
        raise
