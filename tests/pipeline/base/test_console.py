"""What a user sees when a stage ends badly."""

import errno
import subprocess
import sys
from collections.abc import Callable

import pytest

from pipeline.base import console
from pipeline.base.errors import InputError, closest


def raising(error: BaseException) -> Callable[[], None]:
    def main() -> None:
        raise error

    return main


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (InputError("a is wrong:\n  do b"), 1, "error: a is wrong: do b\n"),
        (
            OSError(errno.ENOSPC, "No space left on device", "data/x.h5"),
            1,
            "error: No space left on device while writing data/x.h5",
        ),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), 1, "error: Disk quota exceeded. Free some space"),
        (KeyboardInterrupt(), 130, "error: interrupted: finished drives are kept"),
    ],
)
def test_one_line_and_a_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: BaseException, status: int, line: str
) -> None:
    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(SystemExit) as end:
        console.run(raising(error))
    printed = capsys.readouterr().err.lstrip("\n")
    assert end.value.code == status
    assert printed.startswith(line)
    assert printed.count("\n") == 1


@pytest.mark.parametrize("error", [ValueError("a bug"), PermissionError(errno.EACCES, "Permission denied")])
def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(type(error)):
        console.run(raising(error))


def test_workers_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEER_WORKERS", "3")
    assert console.default_workers() == 3
    monkeypatch.delenv("STEER_WORKERS")
    assert console.default_workers() >= 1
    for text in ("0", "-1", "two", "1.5"):
        monkeypatch.setenv("STEER_WORKERS", text)
        with pytest.raises(InputError, match=f"STEER_WORKERS='{text}' is no positive whole number"):
            console.default_workers()


def test_closest_names() -> None:
    assert closest("gn", ["gnn", "pointnet2"]) == "did you mean gnn?"
    assert closest("xyz", ["gnn", "pointnet2"]) == "known: gnn, pointnet2"
    assert closest("xyz", []) == "known: none"


@pytest.mark.parametrize("stage", ["labels", "ingest"])
def test_help_loads_nothing_heavy(stage: str) -> None:
    program = (
        f"import sys, stages.{stage}\n"
        "print([name for name in ('torch', 'open3d', 'cv2', 'scipy', 'pykitti', 'PIL') if name in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
