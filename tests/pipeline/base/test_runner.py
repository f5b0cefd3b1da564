"""The runner's contract, on a toy stage: whatever ends a run, finished drives are kept and no file is half-written."""

import errno
import os
import shutil
import signal
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.runner import Job, run_over_drives
from pipeline.base.store import write_index
from tests.kitti_drive import contents
from tests.kitti_drive import write as write_file
from tests.pipeline.base import toy_stage
from tests.pipeline.base.toy_stage import DRIVES, alive, calls, end_trouble, outputs, start, trouble, wait_for, waiting


@pytest.mark.parametrize("workers", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_bytes_do_not_depend_on_workers(
    folder: Path, expected: dict[str, bytes], workers: int, capsys: pytest.CaptureFixture[str]
) -> None:
    summaries = toy_stage.main(folder, workers=workers)
    assert summaries == {drive: {"frames": toy_stage.FRAMES[drive]} for drive in DRIVES}
    assert list(summaries) == DRIVES
    assert outputs(folder) == expected
    assert calls(folder) == DRIVES
    assert [path.name for path in (folder / "data/.resume").iterdir()] == ["toy.lock"]
    lines = capsys.readouterr().out.splitlines()
    assert {line.split(",")[0] for line in lines} == {f"{name}: {n} frames" for name, n in toy_stage.FRAMES.items()}
    if workers == 1:
        assert [line.split(":")[0] for line in lines] == ["b", "c", "a", "empty"], "the longest first"


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_error_names_drive_and_frame_and_keeps_finished_drives(
    folder: Path, expected: dict[str, bytes], workers: int, monkeypatch: Any, capsys: Any
) -> None:
    trouble(folder, c="fail")
    with pytest.raises(DamagedFile) as raised:
        toy_stage.main(folder, workers=workers)
    assert raised.value.where == "c frame 2: 0.png"
    assert outputs(folder) == {}, "the stage's folder is filled at the end"
    assert "b" in calls(folder)
    end_trouble(folder)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    capsys.readouterr()
    toy_stage.main(folder, workers=workers)
    repeated = calls(folder)
    assert "c" in repeated
    assert "b" not in repeated
    assert outputs(folder) == expected
    printed = capsys.readouterr()
    assert "of 4 drives kept from the run before" in printed.out
    assert "4/4" in printed.err.split("\r")[-1], "the bar counts kept drives, too"
    assert " 0/4" not in printed.err


@pytest.mark.slow
def test_a_dead_worker_is_one_error_and_keeps_finished_drives(folder: Path, expected: dict[str, bytes]) -> None:
    trouble(folder, a="die")
    with pytest.raises(InputError) as raised:
        toy_stage.main(folder, workers=2)
    assert "a" in raised.value.where.removeprefix("at or near ").split(", ")
    assert "STEER_WORKERS=1" in raised.value.fix
    assert "a" in calls(folder)
    end_trouble(folder)
    toy_stage.main(folder, workers=1)
    assert not {"b", "c"} <= set(calls(folder)), "the drive before a is kept; the other one may have died with a"
    assert outputs(folder) == expected


@pytest.mark.slow
def test_a_full_disk_names_the_file_and_leaves_no_temporary_one(folder: Path, expected: dict[str, bytes]) -> None:
    trouble(folder, c="full")
    with pytest.raises(OSError, match=r"toy/c-") as raised:
        toy_stage.main(folder, workers=2)
    assert raised.value.errno == errno.EFBIG
    kept = [path.name.split("-")[0] for path in (folder / "data/.resume/toy").iterdir()]
    assert set(kept) <= {"a", "b", "empty"}
    end_trouble(folder)
    toy_stage.main(folder, workers=1)
    assert outputs(folder) == expected


def write(drive: str, path: Path) -> dict[str, Any]:
    path.write_text(drive)
    return {"drive": drive}


def run(out: Path, target: str = "{}.h5", stage: str = "labels", interrupt: bool = False) -> None:
    jobs = [Job(drive, out / target.format(drive), [], partial(write, drive)) for drive in DRIVES]
    with run_over_drives(stage, {}, jobs, out, workers=1) as summaries:
        assert summaries == {drive: {"drive": drive} for drive in DRIVES}
        if interrupt:
            raise KeyboardInterrupt


def test_only_files_of_drives_of_an_earlier_index_are_removed(tmp_path: Path) -> None:
    out = tmp_path / "data/stage"
    foreign = dict.fromkeys(("own.h5", "own.txt", "below/own.h5", "below/old.h5"), b"foreign")
    for name, content in {**foreign, "a.h5": b"earlier", "old.h5": b"earlier"}.items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(content)
    (tmp_path / "data/outside.h5").touch()
    write_file(tmp_path / "data/.resume/stage.lock", "")  # of an earlier run
    write_index(out, {"a": "train", "old": "train", "gone": "val", "../outside": "test"})
    index = (out / "index.json").read_bytes()
    run(out)
    assert contents(out) == {f"{drive}.h5": drive.encode() for drive in DRIVES} | foreign | {"index.json": index}
    assert (tmp_path / "data/outside.h5").exists()
    (out / "index.json").write_text('{"drives": [7]}')
    write_file(tmp_path / ".resume/data-stage.lock", "")
    run(out, "more/{}/result.json", stage="graphs@stage")
    assert (out / "more/b/result.json").read_text() == "b", "a summary beside a .json file does not replace it"
    assert (out / "a.h5").exists()
    assert [path.name for path in (tmp_path / ".resume").iterdir()] == ["data-stage.lock"]


def replace_by_folder(path: Path) -> None:
    path.unlink()
    write_file(path / "file", "content")


@pytest.mark.parametrize(
    ("file", "damage"),
    [
        ("b-*.h5.json", lambda path: path.write_text("{")),
        ("b-*.h5.json", lambda path: path.write_text("[]")),
        ("b-*.h5.json", lambda path: path.write_text("{}")),
        ("b-*.h5.json", lambda path: path.write_text('{"summary": {}, "sha256": ""}')),
        ("b-*.h5.json", lambda path: path.write_bytes(b"\xff")),
        ("b-*.h5.json", replace_by_folder),
        ("b-*.h5", Path.unlink),
    ],
)
def test_a_damaged_kept_drive_is_made_again(tmp_path: Path, file: str, damage: Callable[[Path], object]) -> None:
    out = tmp_path / "data/stage"
    with pytest.raises(KeyboardInterrupt):
        run(out, interrupt=True)
    (path,) = (tmp_path / "data/.resume/stage").glob(file)
    damage(path)
    run(out)
    assert contents(out) == {f"{drive}.h5": drive.encode() for drive in DRIVES}


def test_the_stage_folder_may_be_a_link_to_another_file_system(tmp_path: Path, tmp_path_factory: Any) -> None:
    elsewhere = Path("/dev/shm") / f"test-runner-{os.getpid()}"
    elsewhere.mkdir()
    (tmp_path / "data").mkdir()
    (tmp_path / "data/stage").symlink_to(elsewhere)
    other = tmp_path / "data/.resume/stage-2/key.h5"
    other.parent.mkdir(parents=True)
    other.touch()
    try:
        run(tmp_path / "data/stage")
        assert contents(elsewhere) == {f"{drive}.h5": drive.encode() for drive in DRIVES}
    finally:
        for path in elsewhere.iterdir():
            path.unlink()
        elsewhere.rmdir()
    assert (tmp_path / "data/stage").is_symlink()
    assert other.exists(), "what waits for another stage's next run"


@pytest.mark.slow
@pytest.mark.parametrize(("number", "status"), [(signal.SIGKILL, -9), (signal.SIGINT, 130)], ids=["kill", "ctrl-c"])
def test_a_killed_run_resumes_and_leaves_no_process(
    folder: Path, expected: dict[str, bytes], number: signal.Signals, status: int
) -> None:
    trouble(folder, a="wait", c="wait")
    with start(folder, "--workers", "2") as process:
        pids = waiting(folder, "ac")
        wait_for(lambda: len(list((folder / "data/.resume/toy").glob("*.json"))) >= 1)
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # as a terminal sends Ctrl-C
        else:
            process.send_signal(number)
        _, errors = process.communicate(timeout=30)
    assert process.returncode == status, errors
    if number == signal.SIGINT:
        assert errors.startswith("error: interrupted")
        assert errors.count("\n") == 1
    wait_for(lambda: not any(alive(pid) for pid in pids))
    end_trouble(folder)
    calls(folder)
    toy_stage.main(folder, workers=1)
    assert "b" not in calls(folder)
    assert outputs(folder) == expected


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_kill_before_the_index_keeps_all_drives(folder: Path, expected: dict[str, bytes], workers: int) -> None:
    trouble(folder, index="wait")
    with start(folder, "--workers", str(workers)) as process:
        waiting(folder, ["index"])
        with pytest.raises(InputError, match="another process"):
            toy_stage.main(folder)
        process.kill()
    assert outputs(folder).keys() == expected.keys() - {"index.json"}
    assert calls(folder) == DRIVES
    end_trouble(folder)
    shutil.rmtree(folder / "data/toy")  # as DVC does
    toy_stage.main(folder, workers=1)
    assert calls(folder) == []
    assert outputs(folder) == expected
    assert [path.name for path in (folder / "data/.resume").iterdir()] == ["toy.lock"]
