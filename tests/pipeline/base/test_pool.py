"""Running over drives: whatever ends a run, what was finished is kept, and nothing is left half-done."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from pipeline.base import progress
from pipeline.base.errors import InputError
from pipeline.base.pool import run_over_drives
from tests.kitti_drive import contents

DRIVES = ["a", "b", "c", "d"]


def work(drive: str, path: Path, log: Path, trouble: dict[str, str]) -> dict[str, Any]:
    """Note the call in `log`, run into the trouble that `drive` has, write a file."""
    with log.open("a") as file:
        file.write(f"{drive}\n")
    match trouble.get(drive):
        case "die":
            os._exit(9)
        case "hang":
            (log.parent / "hanging").mkdir(exist_ok=True)
            (log.parent / "hanging" / str(os.getpid())).touch()
            time.sleep(600)
        case "fail":
            raise InputError(f"{drive} is damaged")
        case "later":
            time.sleep(0.3)
    progress.advance(2)
    path.write_text(f"content of {drive}")
    return {"frames": len(drive), "threads": os.environ.get("OMP_NUM_THREADS")}


def run(tmp_path: Path, trouble: dict[str, str] | None = None, **changes: Any) -> dict[str, Any]:
    out = tmp_path / "data/stage"
    log = tmp_path / "log"
    log.unlink(missing_ok=True)
    options: dict[str, Any] = {"settings": {"k": 6}, "inputs": lambda drive: ["fingerprint"], "workers": 1} | changes
    return run_over_drives(
        partial(work, log=log, trouble=trouble or {}), DRIVES, module="pipeline.base.store", out=out, **options
    )


def calls(tmp_path: Path) -> list[str]:
    return sorted((tmp_path / "log").read_text().split()) if (tmp_path / "log").exists() else []


def finished(tmp_path: Path) -> dict[str, bytes]:
    return contents(tmp_path / "data/stage")


WHOLE = {f"{drive}.h5": f"content of {drive}".encode() for drive in DRIVES}


@pytest.mark.parametrize("workers", [1, 2])
def test_every_drive_gets_its_file(tmp_path: Path, workers: int, capsys: pytest.CaptureFixture[str]) -> None:
    summaries = run(tmp_path, workers=workers, describe=lambda summary: f"{summary['frames']} frames")
    assert [(drive, summary["frames"]) for drive, summary in summaries.items()] == [(drive, 1) for drive in DRIVES]
    assert finished(tmp_path) == WHOLE
    assert calls(tmp_path) == DRIVES
    assert not list((tmp_path / "data/.resume").iterdir()), "on success, nothing waits"
    lines = capsys.readouterr().out.splitlines()
    assert sorted(line.split(",")[0] for line in lines) == [f"{drive}: 1 frames" for drive in DRIVES]
    assert all(line.endswith("frames/s") for line in lines)


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize(("frames", "shown"), [(None, "4/4"), (lambda drive: 2, "8/8")], ids=["drives", "frames"])
def test_on_a_terminal_a_bar_counts_drives_or_frames(
    tmp_path: Path, workers: int, frames: Any, shown: str, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    run(tmp_path, workers=workers, frames=frames)
    bar = capsys.readouterr().err
    assert shown in bar.split("\r")[-1]
    assert ("frames/s" in bar) == (frames is not None)


def test_fewer_drives_than_cores_share_all_of_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEER_WORKERS", "9")
    assert {summary["threads"] for summary in run(tmp_path, workers=None).values()} == {"2"}  # 4 drives


@pytest.mark.parametrize("workers", [1, 2])
def test_a_failed_drive_keeps_the_others(tmp_path: Path, workers: int) -> None:
    with pytest.raises(InputError, match="c is damaged"):
        run(tmp_path, {"c": "fail", "d": "later"}, workers=workers)
    assert finished(tmp_path) == {}, "a stage's folder is filled at the end only"
    done = set(calls(tmp_path)) - {"c"}
    run(tmp_path, workers=workers)
    assert calls(tmp_path) == sorted({*DRIVES} - done)
    assert {"a", "b"} <= done
    assert finished(tmp_path) == WHOLE


def test_a_dead_worker_is_one_line_and_keeps_the_others(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a worker process died \(out of memory\?\) at or near .*STEER_WORKERS=1"):
        run(tmp_path, {"d": "die", "c": "later"}, workers=2)
    run(tmp_path, workers=2)
    assert set(calls(tmp_path)) <= {"b", "c", "d"}
    assert finished(tmp_path) == WHOLE


def test_what_determines_a_file_is_in_its_key(tmp_path: Path) -> None:
    source = tmp_path / "input"
    source.write_text("1")
    first: dict[str, Any] = {"settings": {"k": 6}, "inputs": lambda drive: [source, "fingerprint"]}

    def leave_three_finished() -> None:
        with pytest.raises(InputError):
            run(tmp_path, {"d": "fail"}, **first)

    leave_three_finished()
    run(tmp_path, **first)
    assert calls(tmp_path) == ["d"]

    for change in ({"settings": {"k": 7}}, {"inputs": lambda drive: [source, "another"]}):
        leave_three_finished()
        run(tmp_path, **(first | change))
        assert calls(tmp_path) == DRIVES

    leave_three_finished()
    source.write_text("2")
    run(tmp_path, **first)
    assert calls(tmp_path) == DRIVES


def test_missing_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere is missing: dvc repro makes it"):
        run(tmp_path, inputs=lambda drive: [tmp_path / "nowhere"])


def test_targets_and_resume_folder_may_lie_elsewhere(tmp_path: Path) -> None:
    run(tmp_path, target=lambda drive: tmp_path / "data/stage" / drive / "x.bin", resume=tmp_path / "kept")
    assert sorted(finished(tmp_path)) == [f"{drive}/x.bin" for drive in DRIVES]
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize(("number", "status"), [(signal.SIGKILL, -9), (signal.SIGINT, 130)], ids=["kill", "ctrl-c"])
def test_a_killed_run_resumes_and_leaves_no_process(tmp_path: Path, number: signal.Signals, status: int) -> None:
    program = """
if __name__ == "__main__":
    from pathlib import Path
    from pipeline import console
    from tests.pipeline.test_drives import run

    def main(tmp_path: Path) -> None:
        run(tmp_path, {"b": "hang", "d": "hang"}, workers=2)

    console.run(main)
"""
    (tmp_path / "program.py").write_text(program)
    root = str(Path(__file__).resolve().parents[3])
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "program.py"), str(tmp_path)],
        env=os.environ | {"PYTHONPATH": root},
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # ignored if the tests run in the background
    )
    kept = tmp_path / "data/.resume/stage"
    _wait_for(lambda: len(list((tmp_path / "hanging").glob("*"))) == len(list(kept.glob("*.json"))) == 2)
    if number == signal.SIGINT:
        os.killpg(process.pid, number)  # a terminal sends Ctrl-C to the whole group
    else:
        process.send_signal(number)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == status, errors
    if number == signal.SIGINT:
        assert errors.startswith("error: interrupted")
        assert errors.count("\n") == 1
    workers = [int(path.name) for path in (tmp_path / "hanging").iterdir()]
    assert len(workers) == 2
    _wait_for(lambda: not any(_alive(pid) for pid in workers))

    run(tmp_path)
    assert calls(tmp_path) == ["b", "d"]
    assert finished(tmp_path) == WHOLE


def _alive(pid: int) -> bool:
    """A process that has ended but that nobody waited for (a zombie) is not alive."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def _wait_for(condition: Any) -> None:
    for _ in range(300):
        if condition():
            return
        time.sleep(0.1)
    raise TimeoutError
