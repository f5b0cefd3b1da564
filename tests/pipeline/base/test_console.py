"""What a user sees when a stage ends badly."""

import errno
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.base import console
from pipeline.base.errors import InputError
from pipeline.base.store import write_json


def raising(error: BaseException) -> Callable[[], None]:
    def main() -> None:
        raise error

    return main


def one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], main: Callable[[], object], status: int = 1
) -> str:
    """Return the line on stderr with which the command ends."""
    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(SystemExit) as end:
        console.run(main)
    printed = capsys.readouterr().err.lstrip("\n")
    assert end.value.code == status
    assert printed.startswith("error: ")
    assert printed.count("\n") == 1
    return printed


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (InputError("a is wrong:\n  do b"), 1, ["error: a is wrong: do b\n"]),
        (OSError(errno.ENOSPC, "No space left", "data/x.h5"), 1, ["No space left", "data/x.h5", "Free some space"]),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), 1, ["Disk quota exceeded", "Free some space"]),
        (OSError(errno.EFBIG, "File too large", "x"), 1, ["File too large", "x", "Free some space"]),
        (PermissionError(errno.EACCES, "Permission denied", "data/x"), 1, ["denied: data/x", "ls -ld data/x"]),
        (OSError(errno.EROFS, "Read-only file system", "x"), 1, ["Read-only file system: x", "mount"]),
        (OSError(errno.EXDEV, "Invalid link", "x", None, "y"), 1, ["Invalid link: x → y"]),
        (OSError(errno.EIO, "Input/output error"), 1, ["Input/output error", "disk"]),
        (OSError("Can't read data"), 1, ["Can't read data"]),
        (OSError(), 1, ["OSError"]),
        (FileNotFoundError(errno.ENOENT, "No such file", "data/x"), 1, ["No such file: data/x", "dvc pull"]),
        (KeyboardInterrupt(), 130, ["interrupted", "finished drives are kept"]),
    ],
    ids=repr,
)
def test_one_line_and_a_status(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    status: int,
    words: list[str],
) -> None:
    line = one_line(monkeypatch, capsys, raising(error), status)
    for word in words:
        assert word in line


def test_a_file_where_a_folder_is_wanted_and_the_other_way_round(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    for main in (
        lambda: (tmp_path / "file").mkdir(),
        lambda: write_json(tmp_path / "file/below", {}),
        lambda: (tmp_path / "folder").write_text(""),
    ):
        line = one_line(monkeypatch, capsys, main)
        assert str(tmp_path) in line
        assert "move it away" in line


@pytest.mark.parametrize("name", ["link", "link/below/x.json"])
def test_a_link_that_leads_nowhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "unmounted/disk")
    main = (tmp_path / name).mkdir if name == "link" else lambda: write_json(tmp_path / name, {})
    line = one_line(monkeypatch, capsys, main)
    assert f"{tmp_path / 'link'} is a link to {tmp_path / 'unmounted/disk'}, which is missing" in line


def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(ValueError, match="a bug"):
        console.run(raising(ValueError("a bug")))


def test_a_log_that_nobody_reads_any_more() -> None:
    program = (
        "from pipeline.base import console\n"
        "def main() -> None:\n"
        "    for _ in range(100_000): print('a line')\n"
        "console.run(main)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stdout is not None
        assert run.stderr is not None
        run.stdout.close()
        errors = run.stderr.read()
    assert run.returncode == 1
    assert errors.startswith("error: ")
    assert errors.count("\n") == 1


class Exits(list[int]):
    """Stands for os._exit, which would end the tests."""

    def __call__(self, status: int) -> None:
        self.append(status)
        if threading.current_thread() is threading.main_thread():
            raise SystemExit(status)


@pytest.fixture
def exits(monkeypatch: pytest.MonkeyPatch) -> Exits:
    monkeypatch.setattr(sys, "argv", ["stage"])
    monkeypatch.setenv("DVC_STAGE", "train@a model that nobody has")
    exits = Exits()
    monkeypatch.setattr(os, "_exit", exits)
    return exits


def test_a_stage_ends_with_the_dvc_that_started_it(exits: Exits, monkeypatch: pytest.MonkeyPatch) -> None:
    """Here with a pipe in place of DVC's process; with real processes, stages and workers, in test_pool.py."""
    end, dvc = os.pipe()
    asked: list[int] = []
    monkeypatch.setattr(os, "pidfd_open", lambda pid: asked.append(pid) or end)

    def main() -> None:
        assert not exits
        os.close(dvc)
        for _ in range(100):
            if exits:
                return
            time.sleep(0.05)

    with pytest.raises(SystemExit):
        console.run(main)
    os.close(end)
    assert exits == [1]
    assert asked == [os.getppid()], "nobody between"


def test_the_shell_that_dvc_started_is_not_dvc(exits: Exits, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def pidfd_open(pid: int) -> int:
        asked.append(pid)
        raise PermissionError

    monkeypatch.setattr(os, "pidfd_open", pidfd_open)
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "bufsize": 0}
    with subprocess.Popen(["cat"], **pipes) as shell:  # it has DVC_STAGE, and these tests started it
        shell.stdin.write(b"?")
        assert shell.stdout.read(1) == b"?"  # its environment is there once it runs, not as soon as it is made
        monkeypatch.setattr(os, "getppid", lambda: shell.pid)
        with pytest.raises(SystemExit):
            console.run(lambda: None)
        shell.communicate()
    assert asked == [os.getpid()]
    assert not exits


@pytest.mark.parametrize(
    ("error", "statuses"), [(ProcessLookupError(), [1]), (PermissionError(), [])], ids=["ended", "forbidden"]
)
def test_where_dvc_cannot_be_watched(
    exits: Exits, monkeypatch: pytest.MonkeyPatch, error: OSError, statuses: list[int]
) -> None:
    def refuse(pid: int) -> int:
        raise error

    monkeypatch.setattr(os, "pidfd_open", refuse)
    with pytest.raises(SystemExit) as end:
        console.run(lambda: None)
    assert exits == statuses
    assert end.value.code == int(bool(statuses))


def test_the_first_process_of_a_container_is_not_watched(exits: Exits, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getppid", lambda: 1)
    monkeypatch.delattr(os, "pidfd_open")
    with pytest.raises(SystemExit) as end:
        console.run(lambda: None)
    assert end.value.code == 0


def test_workers_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEER_WORKERS", "3")
    assert console.default_workers() == 3
    monkeypatch.delenv("STEER_WORKERS")
    assert console.default_workers() >= 1
    for text in ("0", "-1", "two", "1.5", "²"):
        monkeypatch.setenv("STEER_WORKERS", text)
        with pytest.raises(InputError, match=f"STEER_WORKERS='{text}'.*positive whole number"):
            console.default_workers()


@pytest.mark.parametrize("stage", ["labels", "ingest"])
def test_help_loads_nothing_heavy(stage: str) -> None:
    program = (
        f"import sys, stages.{stage}\n"
        "print([name for name in ('torch', 'open3d', 'cv2', 'scipy', 'pykitti', 'PIL') if name in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
