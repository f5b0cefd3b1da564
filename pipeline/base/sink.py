"""File object that records write errors, which HDF5 and h5py lose."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


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
        left = memoryview(data).cast("B")
        size = len(left)
        try:
            while left:  # the system may write a part only
                left = left[super().write(left) :]
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
