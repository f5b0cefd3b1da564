"""Compute items ahead of their use, in threads."""

from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")
_END: Any = object()


def prefetch(items: Generator[T], ahead: int = 2) -> Generator[T]:
    """Yield the items of a generator in order; one thread computes up to `ahead` of them in advance.

    This helps where an item waits for a disk or for a library that releases Python's lock, as HDF5 and torch do.
    Closing this generator waits for the item in progress and closes `items`.
    """
    with closing(items), ThreadPoolExecutor(1, "prefetch") as pool:
        yield from _results(iter(lambda: pool.submit(next, items, _END), None), ahead, pool)


def side_by_side(
    work: Callable[[T], R], items: Generator[T], threads: int, ahead: int, start: Callable[[], object] | None = None
) -> Generator[R]:
    """Yield ``work(item)`` of each item, in order; `threads` threads work, and the caller's thread computes the items.

    At most `ahead` results exist besides the one at the caller. Closing this generator waits for work in progress and
    closes `items`. `start` is called once in each thread.
    """
    with closing(items), ThreadPoolExecutor(threads, "prefetch", initializer=start) as pool:
        yield from _results((pool.submit(work, item) for item in items), ahead, pool)


def _results(futures: Iterator[Future[Any]], ahead: int, pool: ThreadPoolExecutor) -> Generator[Any]:
    ready: deque[Future[Any]] = deque()
    try:
        for future in futures:
            ready.append(future)
            if len(ready) > ahead:
                if (result := ready.popleft().result()) is _END:
                    return
                yield result
        yield from (future.result() for future in ready)
    finally:
        pool.shutdown(cancel_futures=True)
