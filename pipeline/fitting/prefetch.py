"""Reading ahead: a thread makes the next items while the caller works on this one."""

from collections import deque
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from typing import TypeVar

T = TypeVar("T")
_END = object()


def prefetch(items: Generator[T], ahead: int = 2) -> Generator[T]:
    """Yield the same items in the same order; one thread keeps up to `ahead` of them ready.

    It pays where making an item waits for a disk or runs in a library that lets go of Python's lock, as HDF5 and torch
    do. An error in `items` is raised where the item would have come. Closing this generator, or leaving it before its
    end, ends the thread and closes `items`.
    """
    with closing(items), ThreadPoolExecutor(1, "prefetch") as pool:
        ready = deque(pool.submit(next, items, _END) for _ in range(ahead))
        try:
            while (item := ready.popleft().result()) is not _END:
                ready.append(pool.submit(next, items, _END))
                yield item  # type: ignore[misc]  # _END is no item
        finally:
            for later in ready:
                later.cancel()
