"""Help loops over batches: prefetch batches in threads, and vary the learning rate."""

import math
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def prefetch(
    work: Callable[[T], R],
    items: Iterable[T],
    threads: int = 1,
    ahead: int = 2,
    init: Callable[[], None] | None = None,
) -> Generator[R]:
    """Yield ``work(item)`` of each item, in order, computed by `threads` threads.

    `items` themselves are computed in the caller's thread. Threads help where `work` waits for a
    disk, or for a library that releases Python's lock. At most `ahead` results exist besides the
    one that the caller has. Closing this generator waits for work in progress. Each thread calls
    `init` first.
    """
    with ThreadPoolExecutor(threads, "prefetch", initializer=init) as pool:
        ready: deque[Future[R]] = deque()
        try:
            for item in items:
                ready.append(pool.submit(work, item))
                if len(ready) > ahead:
                    yield ready.popleft().result()
            for future in ready:
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def warm_up_cosine(progress: float, warm_up: float) -> float:
    """Return the factor of the learning rate at `progress` of the training, which is in [0,1].

    The factor rises linearly from 0.05 to 1 at `warm_up`, then falls to 0 as half a cosine.
    """
    if progress < warm_up:
        return 0.05 + 0.95 * progress / warm_up
    return 0.5 * (1 + math.cos(math.pi * (progress - warm_up) / (1 - warm_up)))
