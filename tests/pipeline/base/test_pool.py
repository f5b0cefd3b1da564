"""Running over drives: whatever ends a run, what was finished is kept, and nothing is left half-done."""

import errno
import json
import os
import resource
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.base import progress
from pipeline.base.errors import InputError
from pipeline.base.pool import run_over_drives, run_side_by_side
from pipeline.base.store import DriveWriter, write_index
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
            wait_for((log.parent / "go").exists)
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


HANG = {"b": "hang", "d": "hang"}  # until there is a file called go
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


@pytest.mark.slow
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


def note(job: str, folder: Path, trouble: dict[str, str]) -> None:
    """Leave a file that tells how many threads there are, or run into the trouble that `job` has."""
    match trouble.get(job):
        case "die":
            os._exit(9)
        case "fail":
            raise InputError(f"{job} is damaged")
    (folder / job).write_text(os.environ["OMP_NUM_THREADS"])


def side_by_side(folder: Path, trouble: dict[str, str], workers: int) -> None:
    work = partial(note, folder=folder, trouble=trouble)
    run_side_by_side(work, DRIVES, module="pipeline.base.store", mark=folder, workers=workers)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 3])
def test_side_by_side_each_has_one_thread_however_many_there_are(tmp_path: Path, workers: int) -> None:
    side_by_side(tmp_path, {}, workers)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(DRIVES, "1")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("trouble", "message"), [("fail", "^b is damaged$"), ("die", r"worker process died .* near [a-d]: ")]
)
def test_side_by_side_the_first_error_is_told(tmp_path: Path, trouble: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        side_by_side(tmp_path, {"b": trouble}, 1)
    assert not (tmp_path / "b").exists()


def test_missing_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere is missing: dvc repro makes it"):
        run(tmp_path, inputs=lambda drive: [tmp_path / "nowhere"])


def test_targets_and_resume_folder_may_lie_elsewhere(tmp_path: Path) -> None:
    run(tmp_path, target=lambda drive: tmp_path / "data/stage" / drive / "x.bin", resume=tmp_path / "kept")
    assert sorted(finished(tmp_path)) == [f"{drive}/x.bin" for drive in DRIVES]
    assert not (tmp_path / "kept").exists()
    assert not (tmp_path / "kept.lock").exists()


def test_a_folder_may_be_a_link_to_another_file_system(tmp_path: Path) -> None:
    with tempfile.TemporaryDirectory(dir="/dev/shm") as elsewhere:
        (tmp_path / "data").mkdir()
        (tmp_path / "data/stage").symlink_to(elsewhere)
        run(tmp_path)
        assert contents(Path(elsewhere)) == WHOLE
        assert (tmp_path / "data/stage").is_symlink()


def test_only_what_an_earlier_run_wrote_is_removed(tmp_path: Path) -> None:
    out = tmp_path / "data/stage"
    own = dict.fromkeys(("own.h5", "own.txt", "a.png", "below/own.h5", "below/old.h5", ".own.h5.tmp"), b"my own")
    for name, content in {**own, "a.h5": b"earlier", "old.h5": b"earlier"}.items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(content)
    (tmp_path / "data/outside.h5").touch()
    write_index(out, {"a": "train", "old": "train", "gone": "val", "../outside": "test"})
    index = (out / "index.json").read_bytes()
    run(tmp_path)
    assert finished(tmp_path) == WHOLE | own | {"index.json": index}
    assert (tmp_path / "data/outside.h5").exists()


@pytest.mark.parametrize("index", ["", "[]", "{}", '{"drives": [7]}', '{"drives": null}'])
def test_an_index_that_is_none_removes_nothing(tmp_path: Path, index: str) -> None:
    out = tmp_path / "data/stage"
    out.mkdir(parents=True)
    (out / "index.json").write_text(index)
    (out / "old.h5").write_text("earlier")
    run(tmp_path)
    assert finished(tmp_path) == WHOLE | {"index.json": index.encode(), "old.h5": b"earlier"}


def test_an_index_of_each_kind_counts_for_its_folder(tmp_path: Path) -> None:
    """As stage clouds has them: its drives are called pseudo/a, lidar/a, …"""
    out = tmp_path / "data/stage"
    for kind in ("x", "y"):
        write_index(out / kind, {"a": "train", f"old-{kind}": "train"})
        for drive in ("a", "old-x", "old-y"):
            (out / kind / f"{drive}.h5").touch()
    run(tmp_path, target=lambda drive: out / ("x" if drive in "ab" else "y") / f"{drive}.h5")
    names = [str(path.relative_to(out)) for path in sorted(out.glob("*/*.h5"))]
    assert names == ["x/a.h5", "x/b.h5", "x/old-y.h5", "y/c.h5", "y/d.h5", "y/old-x.h5"]


def test_other_stages_keep_what_waits_for_their_next_run(tmp_path: Path) -> None:
    other = tmp_path / "data/.resume/stage-2/key.h5"
    other.parent.mkdir(parents=True)
    other.touch()
    run(tmp_path)
    assert list((tmp_path / "data/.resume").rglob("*")) == [other.parent, other]


def overflow(drive: str, path: Path) -> dict[str, Any]:
    """Write a large file where no file may be so large, as on a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
    with DriveWriter(path, stage="ingest", drive=drive, params={}) as file:
        file.put("image", np.random.default_rng(0).integers(0, 256, (9, 300, 400), np.uint8))
    return {}


@pytest.mark.slow
def test_a_full_disk_in_a_worker_is_an_oserror_with_the_file(tmp_path: Path) -> None:
    out = tmp_path / "stage"
    with pytest.raises(OSError, match=str(tmp_path)) as error:
        run_over_drives(
            overflow, DRIVES, module="pipeline.base.store", out=out, inputs=lambda drive: [], settings={}, workers=2
        )
    assert error.value.errno == errno.EFBIG
    assert Path(str(error.value.filename)).parent == tmp_path / ".resume/stage"
    assert not list((tmp_path / ".resume/stage").iterdir())


PROGRAM = """
if __name__ == "__main__":
    import json
    from pathlib import Path
    from pipeline.base import console
    from tests.pipeline.base.test_pool import run

    def main(tmp_path: Path, trouble: str) -> None:
        run(tmp_path, json.loads(trouble), workers=2)

    console.run(main)
"""


def command(tmp_path: Path, trouble: dict[str, str]) -> list[str]:
    """Return the command of a stage that runs :func:`run` with two workers."""
    (tmp_path / "program.py").write_text(PROGRAM)
    return [sys.executable, str(tmp_path / "program.py"), str(tmp_path), json.dumps(trouble)]


def environment(**variables: str) -> dict[str, str]:
    root = str(Path(__file__).resolve().parents[3])
    return {name: value for name, value in os.environ.items() if name != "DVC_STAGE"} | {"PYTHONPATH": root} | variables


def start(arguments: list[str], **options: Any) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        arguments,
        env=environment(),
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # ignored if the tests run in the background
        **options,
    )


def wait_until_it_hangs(tmp_path: Path) -> list[int]:
    """Wait until two drives are finished and two hang; return the ids of the stage and of its workers."""
    kept = tmp_path / "data/.resume/stage"
    hanging = tmp_path / "hanging"
    wait_for(lambda: len(list(hanging.glob("*"))) == 2 and len(list(kept.glob("*.json"))) == 2)
    workers = [int(path.name) for path in hanging.iterdir()]
    parents = {int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1]) for pid in workers}
    assert len(parents) == 1
    return [*parents, *workers]


@pytest.mark.slow
@pytest.mark.parametrize(("number", "status"), [(signal.SIGKILL, -9), (signal.SIGINT, 130)], ids=["kill", "ctrl-c"])
def test_a_killed_run_resumes_and_leaves_no_process(tmp_path: Path, number: signal.Signals, status: int) -> None:
    with start(command(tmp_path, HANG)) as process:
        pids = wait_until_it_hangs(tmp_path)
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # a terminal sends Ctrl-C to the whole group
        else:
            process.send_signal(number)
        _, errors = process.communicate(timeout=30)
    assert process.returncode == status, errors
    if number == signal.SIGINT:
        assert errors.startswith("error: interrupted")
        assert errors.count("\n") == 1
    wait_for(lambda: not any(alive(pid) for pid in pids))

    run(tmp_path)
    assert calls(tmp_path) == ["b", "d"]
    assert finished(tmp_path) == WHOLE


FAKE_DVC = (
    "import os, subprocess, sys; subprocess.run(['sh', '-c', sys.argv[1]], env=os.environ | {'DVC_STAGE': 's@x'})"
)


def by_dvc(arguments: list[str], then: str = "") -> list[str]:
    """Return the command of something that runs `arguments` as DVC does, by a shell, which turns into what is last."""
    return [sys.executable, "-c", FAKE_DVC, shlex.join(arguments) + then]


@pytest.mark.slow
@pytest.mark.parametrize("then", ["", "; true"], ids=["the shell turns into it", "the shell stays"])
def test_a_stage_ends_when_dvc_is_killed(tmp_path: Path, then: str) -> None:
    with start(by_dvc(command(tmp_path, HANG), then)) as process:
        pids = wait_until_it_hangs(tmp_path)
        assert process.pid not in pids
        process.kill()
        process.wait()
        wait_for(lambda: not any(alive(pid) for pid in pids))

    run(tmp_path)
    assert calls(tmp_path) == ["b", "d"]
    assert finished(tmp_path) == WHOLE


@pytest.mark.slow
@pytest.mark.parametrize("dvc", [False, True], ids=["by hand", "by DVC"])
def test_a_run_in_the_background_outlives_its_shell(tmp_path: Path, dvc: bool) -> None:
    arguments = command(tmp_path, HANG)
    arguments = by_dvc(arguments) if dvc else arguments
    subprocess.run(["sh", "-c", f"nohup {shlex.join(arguments)} > {tmp_path}/output 2>&1 &"], env=environment())
    pids = wait_until_it_hangs(tmp_path)
    time.sleep(0.5)
    assert all(alive(pid) for pid in pids)
    (tmp_path / "go").touch()
    wait_for(lambda: finished(tmp_path) == WHOLE)
    wait_for(lambda: not any(alive(pid) for pid in pids))


@pytest.mark.slow
def test_a_second_run_on_the_same_folder_is_refused_and_harms_nothing(tmp_path: Path) -> None:
    with start(command(tmp_path, HANG)) as first:
        pids = wait_until_it_hangs(tmp_path)
        second = subprocess.run(command(tmp_path, {}), env=environment(), capture_output=True, text=True)
        assert second.returncode == 1
        assert second.stderr.count("\n") == 1
        for words in (str(tmp_path / "data/stage"), f"process {pids[0]}", f"kill {pids[0]}"):
            assert words in second.stderr
        (tmp_path / "go").touch()
        _, errors = first.communicate(timeout=30)
    assert first.returncode == 0, errors
    assert calls(tmp_path) == [], "the second, which starts the log anew, called nothing"
    assert finished(tmp_path) == WHOLE
    assert not list((tmp_path / "data/.resume").iterdir())


def alive(pid: int) -> bool:
    """A process that has ended but that nobody waited for (a zombie) is not alive."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def wait_for(condition: Any) -> None:
    for _ in range(300):
        if condition():
            return
        time.sleep(0.1)
    raise TimeoutError
