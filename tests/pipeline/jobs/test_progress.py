"""A training says how far it is: by a bar on a terminal, otherwise by a line."""

import sys
import time
from collections.abc import Iterator
from threading import Timer
from unittest.mock import Mock

import pytest

from pipeline.jobs import progress
from pipeline.jobs.progress import Progress


class FiredTimer(Timer):
    """A timer whose time has passed when it starts."""

    def start(self) -> None:
        self.function()


@pytest.fixture
def seconds(monkeypatch) -> Iterator[Mock]:
    """Let each look at the clock be 6 s after the one before."""
    clock = Mock(side_effect=range(0, 600, 6))
    monkeypatch.setattr(time, "perf_counter", clock)
    return clock


def test_a_line_says_how_far_a_slow_first_epoch_is(monkeypatch, capsys, seconds):
    monkeypatch.setattr(progress, "Timer", FiredTimer)
    watched = Progress("net seed 0", epochs=3, has_bar=False)
    assert [*watched.watch_steps("abcd", 2, 4)] == [*"abcd"]
    expected = "net seed 0: epoch 2 of 3, 0 of 4 steps in 6 s\n"
    expected += "net seed 0: epoch 2 of 3, 1 of 4 steps in 12 s, ETA 84 s\n"
    assert capsys.readouterr().out == expected
    assert [*watched.watch_steps("ab", 3, 2)] == [*"ab"]
    assert capsys.readouterr() == ("", "")


def test_the_line_comes_while_a_step_takes_long(monkeypatch, capsys):
    monkeypatch.setattr(progress, "LINE_AFTER_S", 0.01)
    steps = Progress("net seed 0", epochs=1, has_bar=True).watch_steps("ab", 1, 2)
    next(steps)
    printed = ""
    end_s = time.monotonic() + 60
    while not printed and time.monotonic() < end_s:
        printed = capsys.readouterr().out
    assert printed.startswith("net seed 0: epoch 1 of 1, 0 of 2 steps in")


def test_a_quick_epoch_prints_nothing(capsys):
    watched = Progress("net seed 0", epochs=1, has_bar=True)
    assert [*watched.watch_steps("ab", 1, 2)] == [*"ab"]
    assert capsys.readouterr() == ("", "")


def test_a_terminal_has_a_bar_in_each_epoch(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    watched = Progress("net seed 0", epochs=2, has_bar=True)
    for epoch in (1, 2):
        assert [*watched.watch_steps("abcd", epoch, 4)] == [*"abcd"]
        printed = capsys.readouterr()
        assert f"net seed 0: epoch {epoch} of 2:   0 %|          | 0 of 4 steps," in printed.err
        assert printed.out == ""
