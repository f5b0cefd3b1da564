"""How far the functions that run over drives have come, told frame by frame, from worker processes too."""

from collections.abc import Callable, Iterable, Iterator
from multiprocessing.sharedctypes import Synchronized
from typing import TypeVar

T = TypeVar("T")


def nobody(frames: int) -> None:
    """Where no bar is shown, as in tests."""


_tell: Callable[[int], object] = nobody
_done = 0


def advance(frames: int) -> None:
    """Say that `frames` more of the drive in work are done."""
    global _done
    _done += frames
    _tell(frames)


def counted(items: Iterable[T]) -> Iterator[T]:
    """Yield the items, one for each frame; a frame is done when the next is asked for."""
    for item in items:
        yield item
        advance(1)


def done() -> int:
    """Return how many frames this process has done: so many more than before name the one at which it failed."""
    return _done


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
