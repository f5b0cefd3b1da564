"""Compute items ahead of their use, in threads."""

from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")
_END = object()


def prefetch(items: Generator[T], ahead: int = 2) -> Generator[T]:
    """Yield the items of a generator in order; one thread computes up to `ahead` of them in advance.

    This helps where an item waits for a disk or for a library that releases Python's lock, as HDF5 and torch do. Errors
    and closing as in :func:`side_by_side`.
    """
    return side_by_side(lambda item: item, items, 1, ahead)


def side_by_side(
    work: Callable[[T], R],
    items: Generator[T],
    threads: int,
    ahead: int,
    start: Callable[[], object] | None = None,
) -> Generator[R]:
    """Yield ``work(item)`` of each item, in order; `threads` threads work, and one more computes the items.

    Besides the result at the caller, at most `ahead` items or results exist. An error in `items` or `work` is raised in
    place of the result. Closing this generator waits for work in progress, ends the threads and closes `items`. `start`
    is called once in each working thread.
    """

    def work_on(item: Future[Any]) -> Any:
        value = item.result()
        return value if value is _END else work(value)

    def submit() -> Future[Any]:
        return pool.submit(work_on, reader.submit(next, items, _END))

    with (
        closing(items),
        ThreadPoolExecutor(1, "prefetch-items") as reader,
        ThreadPoolExecutor(threads, "prefetch-work", initializer=start) as pool,
    ):
        ready = deque(submit() for _ in range(ahead))
        try:
            while (result := ready.popleft().result()) is not _END:
                ready.append(submit())
                yield result
        finally:
            # Work that waits for a cancelled item gets an error, which nothing reads.
            reader.shutdown(cancel_futures=True)
            pool.shutdown(cancel_futures=True)
