"""Help loops over batches: items computed ahead in threads, learning rate, precision."""

import math
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from itertools import count, takewhile
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    import torch

T = TypeVar("T")
R = TypeVar("R")
_END: Any = object()


def prefetch(items: Generator[T], ahead: int = 2) -> Generator[T]:
    """Yield the items of a generator in order; one thread computes up to `ahead` of them in advance.

    This helps where an item waits for a disk or for a library that releases Python's lock, as HDF5 and torch do.
    Closing this generator waits for the item in progress and closes `items`.
    """
    turns = (number for number in count())
    with closing(items), closing(side_by_side(lambda _: next(items, _END), turns, 1, ahead)) as results:
        yield from takewhile(lambda item: item is not _END, results)


def side_by_side(
    work: Callable[[T], R], items: Generator[T], threads: int, ahead: int, start: Callable[[], object] | None = None
) -> Generator[R]:
    """Yield ``work(item)`` of each item, in order; `threads` threads work, and the caller's thread computes the items.

    At most `ahead` results exist besides the one at the caller. Closing this generator waits for work in progress and
    closes `items`. `start` is called once in each thread.
    """
    with closing(items), ThreadPoolExecutor(threads, "prefetch", initializer=start) as pool:
        ready: deque[Future[R]] = deque()
        try:
            for item in items:
                ready.append(pool.submit(work, item))
                if len(ready) > ahead:
                    yield ready.popleft().result()
            yield from (future.result() for future in ready)
        finally:
            pool.shutdown(cancel_futures=True)


def warm_up_cosine(progress: float, warm_up: float) -> float:
    """Return the factor of the learning rate at `progress` in [0,1]: linear up to `warm_up`, then half a cosine."""
    if progress < warm_up:
        return 0.05 + 0.95 * progress / warm_up
    return 0.5 * (1 + math.cos(math.pi * (progress - warm_up) / (1 - warm_up)))


def autocast(device: "torch.device", precision: str) -> "torch.autocast":
    """Return the context of a forward pass.

    With `precision` auto products are in bfloat16 on a GPU that has it, otherwise in the weights' precision.
    """
    import torch

    native = device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
    return torch.autocast(device.type, torch.bfloat16, enabled=precision == "auto" and native)
