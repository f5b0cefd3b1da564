"""Items in order, a bounded number ahead, and no thread left behind."""

import threading
import time
from collections.abc import Generator, Iterator

import pytest

from pipeline.train.prefetch import prefetch, side_by_side


class Source:
    """Count up to `stop`, then raise `error`; record progress, threads and closing."""

    def __init__(self, stop: int, error: Exception | None = None) -> None:
        self.stop, self.error = stop, error
        self.count, self.threads, self.closed = 0, set[str](), False

    def items(self) -> Generator[int]:
        try:
            for number in range(self.stop):
                self.count += 1
                self.threads.add(threading.current_thread().name)
                yield number
            if self.error:
                raise self.error
        finally:
            self.closed = True


@pytest.fixture(autouse=True)
def no_thread_stays() -> Iterator[None]:
    yield
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("prefetch")]


@pytest.mark.parametrize("count", [0, 1, 4, 30])
def test_items_come_in_order_from_one_other_thread(count: int) -> None:
    source = Source(count)
    assert list(prefetch(source.items(), ahead=3)) == list(range(count))
    assert source.closed
    assert threading.current_thread().name not in source.threads
    assert len(source.threads) <= 1


def test_results_come_in_the_order_of_items_whichever_is_ready_first() -> None:
    later = threading.Event()

    def work(number: int) -> int:
        if number == 0:
            assert later.wait(10)
        elif number == 2:
            later.set()
        return number**2

    assert list(side_by_side(work, Source(9).items(), threads=3, ahead=4)) == [number**2 for number in range(9)]


@pytest.mark.parametrize("parallel", [False, True])
def test_the_number_of_items_ahead_is_bounded(parallel: bool) -> None:
    source = Source(100)
    ready = side_by_side(abs, source.items(), threads=3, ahead=4) if parallel else prefetch(source.items(), ahead=4)
    for number in range(5):
        assert next(ready) == number
        time.sleep(0.01)
        assert number + 1 < source.count <= number + 1 + 4
    ready.close()
    assert source.closed


def test_an_error_of_the_items_is_raised_after_them() -> None:
    source, received = Source(4, ValueError("frame 4 is damaged")), []
    with pytest.raises(ValueError, match="frame 4 is damaged"):
        received.extend(prefetch(source.items()))
    assert source.closed
