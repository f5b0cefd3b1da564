"""Replace files and folders in one step, and write HDF5 on a disk that may be full."""

import io
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a unique temporary path beside `path`, which replaces `path` when the block ends without error.

    The block creates a file or a folder there. A folder replaces only an empty folder. The temporary path is
    ``.NAME.????????.tmp/NAME``, so the suffix still gives the format, and a glob for ``*.h5`` does not match.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # A folder of its own, as a file from mkstemp is unreadable for other users.
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent) as folder:
        tmp = Path(folder) / path.name
        yield tmp
        tmp.replace(path)


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
        with self._recording():
            while rest:  # the system may write a part only
                rest = rest[super().write(rest) :]
        return size

    def truncate(self, size: int | None = None) -> int:
        with self._recording():
            super().truncate(size)
        return size or 0

    @contextmanager
    def _recording(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            error.filename = self._path
            self._error = self._error or error

    def check(self) -> None:
        """Raise the recorded error, if there is one."""
        if self._error:
            raise self._error
