"""Errors of commands as a user sees them."""

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.base import console
from pipeline.base.errors import InputError
from pipeline.base.resume import ROOT


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


PRINTING = r"""
from pathlib import Path
from pipeline.base import console

def main() -> None:
    file = Path("file").open("w")
    print("Θ", flush=True)
    print("\udcff", flush=True)
    file.close()

console.run(main)
"""


@pytest.mark.parametrize("closed", ["", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_and_other_encodings_are_no_error(tmp_path: Path, closed: str) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "latin-1"}
    command = ["sh", "-c", f'"{sys.executable}" -c "$0" {closed}', PRINTING]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == ("" if ">&-" in closed.split() else "\\u0398\n\\udcff\n")
    assert (tmp_path / "file").read_text() == ""


@pytest.mark.parametrize("command", ["steer.app --version", "steer.app show -h", "stages.labels --help"])
def test_a_full_output_is_one_line(command: str) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", *command.split()], cwd=ROOT, stdout=full, stderr=subprocess.PIPE, check=False
        )
    assert (done.returncode, done.stderr) == (1, b"error: No space left on device. Nothing was written\n")


@pytest.mark.parametrize("command", [["-m", "stages.clouds"], ["-m", "steer.app", "show"]])
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupt_while_libraries_are_imported(
    tmp_path: Path, command: list[str], number: signal.Signals, status: int
) -> None:
    code = (
        "import time\nprint('imports', flush=True)\ntry:\n  time.sleep(60)\nexcept BaseException:\n  raise ImportError"
    )
    (tmp_path / "typer.py").write_text(code)
    path = os.pathsep.join([str(tmp_path), str(ROOT)])
    environment = os.environ | {"PYTHONPATH": path, "PYTHONSAFEPATH": "1"}
    with subprocess.Popen(
        [sys.executable, *command], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL) and None,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline() == "imports\n"
        process.send_signal(number)
        _, errors = process.communicate()
    assert process.returncode == status
    assert errors.startswith("error: interrupted")
    assert errors.count("\n") == 1
