"""How far the functions that run over drives have come, told frame by frame, from worker processes too."""

from collections.abc import Callable
from multiprocessing.sharedctypes import Synchronized


def nobody(frames: int) -> None:
    """Where no bar is shown, as in tests."""


_tell: Callable[[int], object] = nobody


def advance(frames: int) -> None:
    """Say that `frames` more of the drive in work are done."""
    _tell(frames)


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
