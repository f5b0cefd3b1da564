"""Read files of others with a limit on their size."""

from pathlib import Path

from pipeline.base.errors import DamagedFile

MiB = 1 << 20


def check_file(path: Path, limit: int) -> int:
    """Return the size of a file in bytes. Raises DamagedFile if it is not a regular file or larger than `limit`.

    Raises OSError if it is missing.
    """
    size = path.stat().st_size
    if not path.is_file():
        raise DamagedFile("expected a regular file", path)
    if size > limit:
        raise DamagedFile(f"expected at most {limit} bytes, got {size}", path)
    return size


def read_bytes(path: Path, limit: int) -> bytes:
    """Return the content of a file after :func:`check_file`."""
    check_file(path, limit)
    return path.read_bytes()
