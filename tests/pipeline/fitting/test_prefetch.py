"""Reading ahead: the same items, as many ahead as asked for, and no thread left behind."""

import threading
from collections.abc import Callable, Generator

import pytest

from pipeline.fitting.prefetch import prefetch, side_by_side


class Source:
    """Counts up to `stop`, then fails if told so; remembers how far it came, where it ran and whether it was closed."""

    def __init__(self, stop: int, error: Exception | None = None) -> None:
        self.stop, self.error = stop, error
        self.made, self.threads, self.closed = 0, set[str](), False
        self.at = threading.Condition()

    def items(self) -> Generator[int]:
        try:
            for number in range(self.stop):
                with self.at:
                    self.made += 1
                    self.threads.add(threading.current_thread().name)
                    self.at.notify_all()
                yield number
            if self.error:
                raise self.error
        finally:
            self.closed = True

    def wait(self, condition: Callable[[], bool]) -> bool:
        with self.at:
            return self.at.wait_for(condition, timeout=10)


def reading_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("prefetch")]


@pytest.mark.parametrize("count", [0, 1, 2, 3, 20])
@pytest.mark.parametrize("ahead", [1, 2, 5])
def test_the_same_items_in_the_same_order_from_another_thread(count: int, ahead: int) -> None:
    source = Source(count)
    assert list(prefetch(source.items(), ahead)) == list(range(count))
    assert source.closed
    assert threading.current_thread().name not in source.threads
    assert not reading_threads()


@pytest.mark.parametrize("ahead", [1, 3])
def test_so_many_are_made_while_the_caller_has_one_and_no_more(ahead: int) -> None:
    source = Source(100)
    ready = prefetch(source.items(), ahead)
    for number in range(5):
        assert next(ready) == number
        assert source.wait(lambda least=number + 1 + ahead: source.made >= least), "without the caller asking"
        assert source.made == number + 1 + ahead
    ready.close()


def test_closing_early_ends_the_thread_and_closes_the_source() -> None:
    source = Source(100)
    ready = prefetch(source.items())
    next(ready)
    ready.close()
    assert source.closed
    assert source.made <= 3
    assert not reading_threads()


def test_an_error_arrives_in_its_place_and_ends_the_thread() -> None:
    source = Source(4, ValueError("frame 4 is damaged"))
    seen: list[int] = []
    with pytest.raises(ValueError, match="frame 4 is damaged"):
        seen.extend(prefetch(source.items(), ahead=3))
    assert seen == [0, 1, 2, 3]
    assert source.closed
    assert not reading_threads()


def test_an_error_of_the_caller_ends_the_thread() -> None:
    source = Source(100)

    def consume() -> None:
        for number in prefetch(source.items()):
            if number == 2:
                raise RuntimeError("loss is not finite")

    with pytest.raises(RuntimeError, match="loss is not finite") as caught:
        consume()
    del caught  # it holds the frame that holds the generator
    assert source.closed
    assert not reading_threads()


def test_stages_can_be_chained() -> None:
    source = Source(30)
    squares = prefetch(number**2 for number in prefetch(source.items()))
    assert next(squares) == 0
    squares.close()
    assert source.closed
    assert not reading_threads()


@pytest.mark.parametrize("count", [0, 1, 4, 30])
@pytest.mark.parametrize("threads", [1, 3])
def test_results_come_in_the_order_of_their_items_whichever_is_ready_first(count: int, threads: int) -> None:
    source, later = Source(count), threading.Event()

    def work(number: int) -> int:
        if number == 0 and threads > 1 and count > 1:
            assert later.wait(10), "the next item is worked on at the same time"
        later.set() if number == 1 else None
        return number**2

    assert list(side_by_side(work, source.items(), threads)) == [number**2 for number in range(count)]
    assert source.closed
    assert len(source.threads) <= 1, "one thread makes the items"
    assert not reading_threads()


def test_no_more_is_made_than_threads_can_work_on_and_one() -> None:
    source = Source(100)
    results = side_by_side(str, source.items(), threads=3)
    for number in range(5):
        assert next(results) == str(number)
        assert source.wait(lambda least=number + 1 + 4: source.made >= least), "without the caller asking"
        assert source.made == number + 1 + 4
    results.close()
    assert source.closed
    assert not reading_threads()


@pytest.mark.parametrize("of_work", [True, False])
def test_an_error_of_items_or_work_arrives_in_its_place(of_work: bool) -> None:
    source = Source(20) if of_work else Source(4, ValueError("frame 4"))

    def work(number: int) -> int:
        if number == 4:
            raise ValueError("frame 4")
        return number

    done: list[int] = []
    with pytest.raises(ValueError, match="frame 4"):
        done.extend(side_by_side(work, source.items(), threads=2))
    assert done == [0, 1, 2, 3]
    assert source.closed
    assert not reading_threads()


def test_closing_ends_threads_that_wait_for_their_items() -> None:
    at, go = threading.Event(), threading.Event()

    def slow() -> Generator[int]:
        yield 0
        at.set()
        go.wait(10)
        yield from range(1, 9)

    results = side_by_side(lambda number: number, slow(), threads=2)
    assert next(results) == 0
    assert at.wait(10)
    threading.Timer(0.05, go.set).start()
    results.close()
    assert not reading_threads()


def test_each_thread_that_works_starts_once() -> None:
    started: list[str] = []
    results = side_by_side(
        lambda number: threading.current_thread().name,
        Source(30).items(),
        threads=2,
        start=lambda: started.append(threading.current_thread().name),
    )
    assert set(results) <= set(started)
    assert len(started) == len(set(started)) <= 2
