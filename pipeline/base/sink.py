"""Where HDF5 writes: a file that remembers what went wrong, which HDF5 and h5py lose."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class Sink(io.FileIO):
    """The file below an HDF5 file. It remembers a failure and goes on.

    HDF5 writes much of a file as it closes it, where h5py loses errors: on a full disk, it would leave an incomplete
    file that looks complete, and crash as the process ends.
    """

    def __init__(self, tmp: Path, path: Path) -> None:
        """Write to `tmp`; errors name `path`, which it becomes."""
        super().__init__(tmp, "w+")
        self._path = str(path)
        self._error: OSError | None = None

    def write(self, data: Any) -> int:
        left = memoryview(data).cast("B")
        size = len(left)
        try:
            while left:  # the system may take a part only
                left = left[super().write(left) :]
        except OSError as error:
            self._remember(error)
        return size

    def truncate(self, size: int | None = None) -> int:
        try:
            return super().truncate(size)
        except OSError as error:
            self._remember(error)
        return size or 0

    def _remember(self, error: OSError) -> None:
        error.filename = self._path
        self._error = self._error or error

    def check(self) -> None:
        """Raise the first error there was."""
        if self._error:
            raise self._error

    @contextmanager
    def to_blame(self) -> Iterator[None]:
        """Raise the first error there was in place of what HDF5 says of a file that lacks what it believes written."""
        try:
            yield
        except Exception as error:
            if self._error and error is not self._error:
                raise self._error from error
            raise
        self.check()
