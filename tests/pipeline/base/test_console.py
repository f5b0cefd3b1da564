"""Errors of commands as a user sees them."""

import errno
import os
import signal
import sys
import time
from collections.abc import Callable

import pytest

from pipeline.base import console
from pipeline.base.errors import InputError


def raising(error: BaseException) -> Callable[[], None]:
    def main() -> None:
        raise error

    return main


def one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], main: Callable[[], object], status: int = 1
) -> str:
    """Run the command and return its line on stderr."""
    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(SystemExit) as end:
        console.run(main)
    printed = capsys.readouterr().err.lstrip("\n")
    assert end.value.code == status
    assert printed.startswith("error: ")
    assert printed.count("\n") == 1
    return printed


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (InputError("wrong:\n  value", "a", "Do b"), 1, "a: wrong: value. Do b"),
        (OSError(errno.ENOSPC, "No space left", "data/x.h5"), 1, f"data/x.h5: No space left. {console.RESUME}"),
        (FileNotFoundError(errno.ENOENT, "No such file", "a" * 300), 1, f"{'a' * 300}: No such file. {console.RESUME}"),
        (InputError("missing", "\udcff.png"), 1, "\\udcff.png: missing"),
        (KeyboardInterrupt(), 130, f"interrupted. {console.RESUME}"),
    ],
    ids=repr,
)
def test_errors_are_one_line_and_a_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: BaseException, status: int, line: str
) -> None:
    assert one_line(monkeypatch, capsys, raising(error), status) == f"error: {line}\n"


def test_sigterm_ends_as_ctrl_c_does(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    cleaned_up = []

    def main() -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(60)
        finally:
            cleaned_up.append(True)

    handler = signal.getsignal(signal.SIGTERM)
    try:
        one_line(monkeypatch, capsys, main, status=143)
    finally:
        signal.signal(signal.SIGTERM, handler)
    assert cleaned_up
