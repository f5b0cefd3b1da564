"""The runner's contract, on a toy stage: whatever ends a run, finished drives are kept and no file is half-written."""

import errno
import os
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest

from pipeline.base.errors import DamagedFile, InputError
from tests.pipeline.base import toy_stage
from tests.pipeline.base.toy_stage import DRIVES, alive, calls, end_trouble, outputs, start, trouble, wait_for, waiting


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_bytes_do_not_depend_on_workers(
    folder: Path, expected: dict[str, bytes], workers: int, capsys: pytest.CaptureFixture[str]
) -> None:
    summaries = toy_stage.main(folder, workers=workers)
    assert summaries == {drive: {"frames": toy_stage.FRAMES[drive]} for drive in DRIVES}
    assert list(summaries) == DRIVES
    assert outputs(folder) == expected
    assert calls(folder) == DRIVES
    lines = capsys.readouterr().out.splitlines()
    assert {line.split(",")[0] for line in lines} == {f"{name}: {n} frames" for name, n in toy_stage.FRAMES.items()}
    if workers == 1:
        assert [line.split(":")[0] for line in lines] == ["b", "c", "a", "empty"], "the longest first"


def test_only_what_changed_is_made_again(folder: Path, expected: dict[str, bytes]) -> None:
    """Finished drives stay after success, although DVC deletes the output of a stage before it runs."""
    for drives, k, input_b, made in [
        (["a", "b"], 2, bytes(6), ["a", "b"]),
        (["a", "b", "c"], 2, bytes(6), ["c"]),  # a new drive
        (["a", "b", "c"], 2, b"other", ["b"]),
        (["a", "b", "c"], 3, b"other", ["a", "b", "c"]),
        (DRIVES, 2, bytes(6), DRIVES),
        (DRIVES, 2, bytes(6), []),
    ]:
        shutil.rmtree(folder / "data/toy", ignore_errors=True)
        (folder / "input/b").write_bytes(input_b)
        toy_stage.main(folder, k=k, workers=1, drives=drives)
        assert calls(folder) == made
    assert outputs(folder) == expected
    kept = [path.name.split("-")[0] for path in (folder / "data/.drives/toy").iterdir()]
    assert sorted(kept) == DRIVES, "without the drives of other settings"


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_error_names_the_drive_and_keeps_finished_drives(
    folder: Path, expected: dict[str, bytes], workers: int
) -> None:
    trouble(folder, c="fail")
    with pytest.raises(DamagedFile) as raised:
        toy_stage.main(folder, workers=workers)
    assert raised.value.where == "c: 0.png"
    assert outputs(folder) == {}, "the stage's folder is filled at the end"
    assert "b" in calls(folder)
    end_trouble(folder)
    toy_stage.main(folder, workers=workers)
    repeated = calls(folder)
    assert "c" in repeated
    assert "b" not in repeated
    assert outputs(folder) == expected


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["die", "full"])
def test_a_dead_worker_and_a_full_disk_are_one_error(folder: Path, expected: dict[str, bytes], kind: str) -> None:
    trouble(folder, c=kind)
    with pytest.raises((InputError, OSError)) as raised:
        toy_stage.main(folder, workers=2)
    if isinstance(raised.value, InputError):
        assert "STEER_WORKERS=1" in raised.value.fix
    else:
        assert raised.value.errno == errno.EFBIG
        assert raised.value.filename.endswith("c.h5")
    end_trouble(folder)
    toy_stage.main(folder, workers=1)
    assert outputs(folder) == expected


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_run_keeps_finished_drives_and_leaves_no_process(
    folder: Path, expected: dict[str, bytes], number: signal.Signals
) -> None:
    trouble(folder, a="wait", c="wait")
    with start(folder, "--workers", "2") as process:
        pids = waiting(folder, "ac")
        wait_for(lambda: any((folder / "data/.drives/toy").glob("b-*")))
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # as a terminal sends Ctrl-C
        else:
            process.send_signal(number)
        _, errors = process.communicate(timeout=30)
    assert process.returncode
    if number == signal.SIGINT:
        assert errors.startswith("error: interrupted")
        assert errors.count("\n") == 1
    wait_for(lambda: not any(alive(pid) for pid in pids))
    assert outputs(folder) == {}
    end_trouble(folder)
    calls(folder)
    toy_stage.main(folder, workers=1)
    assert "b" not in calls(folder)
    assert outputs(folder) == expected


def test_a_kill_before_the_index_keeps_all_drives(folder: Path, expected: dict[str, bytes]) -> None:
    trouble(folder, index="wait")
    with start(folder) as process:
        waiting(folder, ["index"])
        process.kill()
    assert outputs(folder) == {}
    assert calls(folder) == DRIVES
    end_trouble(folder)
    toy_stage.main(folder, workers=1)
    assert calls(folder) == []
    assert outputs(folder) == expected


def test_a_worker_count_that_is_no_number_is_refused(folder: Path, monkeypatch: Any) -> None:
    monkeypatch.setenv("STEER_WORKERS", "all")
    with pytest.raises(InputError, match="expected a number of processes"):
        toy_stage.main(folder)
