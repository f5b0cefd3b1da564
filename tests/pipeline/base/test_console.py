"""Errors of commands as a user sees them."""

import errno
import sys
from collections.abc import Callable

import pytest

from pipeline.base import console
from pipeline.base.errors import InputError


def raising(error: BaseException) -> Callable[[], None]:
    def main() -> None:
        raise error

    return main


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (InputError("wrong:\n  value", "a", "Do b"), "a: wrong: value. Do b"),
        (OSError(errno.ENOSPC, "No space left", "data/x.h5"), "data/x.h5: No space left"),
        (OSError(errno.ENOSPC, "No space left"), "No space left"),
        (KeyboardInterrupt(), "interrupted. Repeat the command to continue: complete files are kept"),
    ],
    ids=repr,
)
def test_errors_are_one_line_and_a_status(monkeypatch: pytest.MonkeyPatch, error: BaseException, line: str) -> None:
    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(SystemExit) as end:
        console.run(raising(error))
    assert end.value.code == f"error: {line}"  # Python prints it to stderr and exits with status 1


def test_bugs_keep_their_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(ZeroDivisionError):
        console.run(raising(ZeroDivisionError()))
