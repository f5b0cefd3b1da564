"""A library that crashes or runs in circles ends its own process, and nothing else."""

import multiprocessing
import os
import signal
import threading
from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.inspect import apart as module
from pipeline.inspect import drive_file
from pipeline.inspect.apart import apart

pytestmark = pytest.mark.slow


def test_an_answer_and_an_error_come_back() -> None:
    assert apart(os.fspath, Path("/a/b")) == "/a/b"
    with pytest.raises(InputError, match=r"nowhere\.h5 is missing"):
        apart(drive_file.describe, Path("nowhere.h5"))
    with pytest.raises(FileNotFoundError):
        apart(os.stat, Path("/nowhere"))


def test_a_crash_is_damage_and_the_next_file_is_read() -> None:
    with pytest.raises(InputError, match="is damaged: the library HDF5 crashes"):
        apart(signal.raise_signal, signal.SIGKILL)  # type: ignore[arg-type]
    assert apart(os.fspath, Path("/a/b")) == "/a/b"


def test_no_answer_is_damage_and_the_next_file_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LIMIT_S", 0.2)
    with pytest.raises(InputError, match="finds no end in it"):
        apart(sum, range(10**12))  # type: ignore[arg-type]
    monkeypatch.undo()
    assert apart(os.fspath, Path("/a/b")) == "/a/b"


def test_what_runs_apart_answers_until_nobody_asks() -> None:
    here, there = multiprocessing.Pipe()
    for read, path in ((os.fspath, Path("/a/b")), (os.stat, Path("/nowhere"))):
        here.send((read, (path,), 5.0))
    thread = threading.Thread(target=module._serve, args=(there,))
    thread.start()
    assert here.recv() == (True, "/a/b")
    good, error = here.recv()
    assert not good
    assert isinstance(error, FileNotFoundError)
    here.close()
    thread.join(10)
    assert not thread.is_alive()
