"""Files that others made, read with bounds: a pipe or a device would never end, and some files are a terabyte."""

import stat
from pathlib import Path

from pipeline.base.errors import DamagedFile

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)
MiB = 1 << 20


def check_file(path: Path, most_bytes: int) -> int:
    """Return the size of a file in bytes. Raises DamagedFile if it is no regular file, or larger than `most_bytes`.

    Raises OSError if it is missing.
    """
    status = path.stat()
    for is_kind, kind in _KINDS:
        if is_kind(status.st_mode):
            raise DamagedFile(f"{path} is {kind}, where a file is expected")
    if status.st_size > most_bytes:
        raise DamagedFile(f"{path} has {status.st_size} bytes: a file of its kind has at most {most_bytes}")
    return status.st_size


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """Return what a file holds, once :func:`check_file` let it pass."""
    check_file(path, most_bytes)
    return path.read_bytes()
