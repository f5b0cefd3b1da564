"""Working ahead: threads make the next items while the caller works on this one."""

from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")
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
                yield item  # type: ignore[misc]  # _END is not an item
        finally:
            for later in ready:
                later.cancel()


def side_by_side(
    work: Callable[[T], R], items: Generator[T], threads: int, *, start: Callable[[], object] | None = None
) -> Generator[R]:
    """Yield ``work(item)`` of each item, in the items' order; `threads` threads work, and one more makes the items.

    Beside the result that the caller has, at most `threads` + 1 items or results exist. An error in `items` or `work`
    is raised where the result would have come. Closing this generator, or leaving it before its end, waits for what
    runs, ends the threads and closes `items`.

    Args:
        start: called once in each thread that works, before it does.
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
        ready = deque(submit() for _ in range(threads + 1))
        try:
            while (result := ready.popleft().result()) is not _END:
                ready.append(submit())
                yield result
        finally:
            # What waits for an item that is never made gets an error that nobody reads.
            reader.shutdown(cancel_futures=True)
            pool.shutdown(cancel_futures=True)
