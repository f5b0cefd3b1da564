"""One writer per stage folder. With whole stages: test_pool.py."""

import errno
import fcntl
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.base.lock import exclusive
from tests.kitti_drive import contents

ROOT = Path(__file__).resolve().parents[3]
HOLDER = """
import sys
from pathlib import Path
from pipeline.base.lock import exclusive
with exclusive(Path("stage"), Path(".resume/stage")):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path: Path) -> Any:
    """Another process that holds the lock, until its stdin is closed or it is killed."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def take(tmp_path: Path) -> None:
    with exclusive(tmp_path / "stage", tmp_path / ".resume/stage"):
        assert (tmp_path / ".resume/stage.lock").read_text().split() == [str(os.getpid()), socket.gethostname()]


def test_free_is_taken_and_leaves_no_file(tmp_path: Path) -> None:
    for _ in range(2):
        take(tmp_path)
        assert [path.name for path in (tmp_path / ".resume").iterdir()] == ["stage"]
    with pytest.raises(ZeroDivisionError), exclusive(tmp_path / "stage", tmp_path / ".resume/stage"):
        raise ZeroDivisionError
    take(tmp_path)
    assert not (tmp_path / "stage").exists(), "nothing is written into the stage's folder"


def test_held_is_refused_with_the_process_that_holds_it(tmp_path: Path, holder: "subprocess.Popen[str]") -> None:
    with pytest.raises(InputError) as refused:
        take(tmp_path)
    for words in (f"{tmp_path}/stage", f"process {holder.pid}:", "wait", f"kill {holder.pid}"):
        assert words in str(refused.value)
    assert (tmp_path / ".resume/stage.lock").read_text().split()[0] == str(holder.pid), "the refused one wrote nothing"
    with exclusive(tmp_path / "other", tmp_path / ".resume/other"):
        pass
    holder.communicate()
    assert holder.returncode == 0
    take(tmp_path)


def test_a_killed_holder_holds_nothing(tmp_path: Path, holder: "subprocess.Popen[str]") -> None:
    holder.kill()
    holder.wait()
    assert (tmp_path / ".resume/stage.lock").exists()
    take(tmp_path)
    assert not (tmp_path / ".resume/stage.lock").exists()


@pytest.mark.parametrize(
    ("text", "words"), [("", "another process"), ("77 elsewhere\n", "process 77 on elsewhere")], ids=["none", "far"]
)
def test_who_else_may_hold_it(tmp_path: Path, text: str, words: str) -> None:
    """One that has not written its id yet; one on another machine, in a folder that both see."""
    path = tmp_path / ".resume/stage.lock"
    path.parent.mkdir()
    path.write_text(text)
    with path.open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(InputError, match=words):
            take(tmp_path)


def test_a_file_that_its_holder_removed_meanwhile_is_no_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between open and flock, its holder may end, and one that came later may hold a new file of that name."""
    path = tmp_path / ".resume/stage.lock"
    flock, tries = fcntl.flock, []

    def late(file: Any, how: int) -> None:
        if not tries:
            path.unlink()
        elif len(tries) == 1:
            path.unlink()
            path.touch()
        tries.append(file)
        flock(file, how)

    monkeypatch.setattr(fcntl, "flock", late)
    take(tmp_path)
    assert len(tries) == 3


def test_what_killed_runs_left_is_removed(tmp_path: Path) -> None:
    left = [replacing(tmp_path / name) for name in ("stage/index.json", ".resume/stage/key.h5", ".resume/other/key.h5")]
    for one in left:
        one.__enter__().write_text("half")  # killed here
    take(tmp_path)
    assert [name.split("/")[:2] for name in contents(tmp_path)] == [[".resume", "other"]]


def test_a_file_system_without_locks_is_noted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(number: int) -> Any:
        def flock(file: Any, how: int) -> None:
            raise OSError(number, os.strerror(number))

        return flock

    monkeypatch.setattr(fcntl, "flock", refuse(errno.ENOSYS))
    take(tmp_path)
    assert "cannot be locked" in capsys.readouterr().out
    monkeypatch.setattr(fcntl, "flock", refuse(errno.EIO))
    with pytest.raises(OSError, match="Input/output error"):
        take(tmp_path)


def test_a_full_disk_is_named_and_leaves_the_folder_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(OSError, match=r"No space left on device: .*\.resume/stage\.lock"):
            exclusive(tmp_path / "stage", tmp_path / ".resume/stage").__enter__()
    with exclusive(tmp_path / "stage", tmp_path / ".resume/stage"):
        pass
