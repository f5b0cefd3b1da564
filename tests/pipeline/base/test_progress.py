"""Frames counted as done, and the frame that an error names."""

from collections.abc import Iterator

import pytest

from pipeline.base import progress


@pytest.fixture
def counts() -> Iterator[list[int]]:
    numbers: list[int] = []
    progress.report_to(numbers.append)
    yield numbers
    progress.report_to(None)
    progress.start()


def test_a_frame_counts_when_the_next_one_is_requested(counts: list[int]) -> None:
    frames = progress.track([7, 9])
    assert next(frames) == 7
    assert (progress.current_frame(), sum(counts)) == (7, 0)
    assert next(frames) == 9
    assert (progress.current_frame(), sum(counts)) == (9, 1)
    assert list(frames) == []
    assert (progress.current_frame(), sum(counts)) == (None, 2)


def test_the_frame_of_an_error_stays_until_the_next_drive(counts: list[int]) -> None:
    next(progress.track([3]))
    assert progress.current_frame() == 3
    assert counts == []
    progress.start()
    assert progress.current_frame() is None
