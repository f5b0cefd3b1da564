"""How far the functions that run over drives have come, told frame by frame, from worker processes too."""

from collections.abc import Callable, Iterable, Iterator
from multiprocessing.sharedctypes import Synchronized
from typing import TypeVar

T = TypeVar("T")


def nobody(frames: int) -> None:
    """Where no bar is shown, as in tests."""


_tell: Callable[[int], object] = nobody
_row: int | None = None  # of the block in work; None: no frame is in work


def advance(frames: int) -> None:
    """Say that `frames` more of the drive in work are done."""
    global _row
    if _row is not None:
        _row += frames
    _tell(frames)


def begin(row: int | None = 0) -> None:
    """Say that frames are in work from now on, so that an error is one of a frame; None: that none is."""
    global _row
    _row = row


def row() -> int | None:
    """Return which of the frames since :func:`begin` is in work, numbered from 0."""
    return _row


def counted(items: Iterable[T]) -> Iterator[T]:
    """Yield the items, one for each frame; a frame is done when the next is asked for."""
    begin()
    for item in items:
        yield item
        advance(1)


def listen(tell: Callable[[int], object]) -> None:
    """Have :func:`advance` call `tell` from now on, in this process."""
    global _tell
    _tell = tell


def listen_with(counter: "Synchronized[int]") -> None:
    """Have :func:`advance` add to a counter that processes share."""

    def add(frames: int) -> None:
        with counter.get_lock():
            counter.value += frames

    listen(add)
