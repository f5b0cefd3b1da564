"""Outputs and runs: files are complete however a run ends, and nothing else is lost."""

import errno
import json
import os
import shutil
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pipeline.jobs import console, executors, keys, runner
from pipeline.jobs.outputs import StageFolder, find_free, free_folder, stage_folder

from pipeline.base.errors import InputError
from pipeline.base.store import read_json
from tests.kitti_drive import contents
from tests.kitti_drive import write as write_text
from tests.pipeline.jobs import toy_stage
from tests.pipeline.jobs.toy_stage import DRIVES, alive, calls, outputs, start, trouble, wait_for


def write_stage(out: Path, *files: str) -> None:
    with stage_folder("labels", out, {"a": "train"}) as folder:
        for file in files:
            write_text(folder.new / file, file)


def test_a_stage_replaces_its_files_and_drives_that_are_no_more(tmp_path):
    out = tmp_path / "data/labels"
    write_stage(out, "a.h5", "old.h5", "below/old.txt")
    write_text(out / "own.txt", "foreign")
    before = contents(out)
    with pytest.raises(ZeroDivisionError), stage_folder("labels", out) as folder:  # noqa: PT012
        write_text(folder.new / "b.h5", "half")
        raise ZeroDivisionError
    # As pandas and matplotlib raise it, without a path.
    with pytest.raises(OSError, match=str(out)), stage_folder("labels", out):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with (
        stage_folder("labels", out),
        pytest.raises(InputError, match="another process"),
        stage_folder("labels", out),
    ):
        assert contents(out) == before
    write_stage(out, "a.h5", "b.h5", "below/new.txt")
    assert read_json(out / "index.json", stage="labels") == {"drives": {"a": "train"}}
    assert {*contents(out)} == {"a.h5", "b.h5", "below/new.txt", "own.txt", "index.json"}


def test_a_folder_that_no_stage_wrote_is_refused_unless_dvc_runs(tmp_path, monkeypatch):
    """DVC has emptied its outputs, but files of others may lie beside them."""
    out = tmp_path / "data/out"
    write_text(out / "notes.txt", "foreign")
    with pytest.raises(InputError, match=r"exists already and holds notes\.txt"):
        write_stage(out, "b.h5")
    monkeypatch.setenv("DVC_STAGE", "labels")
    write_stage(out, "b.h5")
    assert contents(out)["notes.txt"] == b"foreign"


@pytest.mark.parametrize(
    ("existing", "expected"),
    [([], "ride"), (["ride/poses.txt", "ride-2/.hidden"], "ride-3"), (["ride"], "ride-2")],
)
def test_a_command_takes_the_first_free_folder(tmp_path, monkeypatch, existing, expected):
    monkeypatch.chdir(tmp_path)
    for name in existing:
        write_text(Path("out") / name, "foreign")
    assert find_free(None, "ride", "") == Path("out") / expected
    with free_folder(None, "ride") as folder, free_folder(None, "ride") as second:
        assert folder == Path("out") / expected
        assert second != folder, "of two commands at once"
        write_text(second / "motion.csv", "result")
    assert not folder.exists()
    assert [path.name for path in second.iterdir()] == ["motion.csv"]


@pytest.fixture
def folder(tmp_path) -> Path:
    return toy_stage.prepare(tmp_path)


@pytest.fixture(scope="module")
def expected(tmp_path_factory) -> dict[str, bytes]:
    """The files that one process writes."""
    folder = toy_stage.prepare(tmp_path_factory.mktemp("serial"))
    toy_stage.main(folder, workers=1)
    return outputs(folder)


@pytest.mark.parametrize(("quota", "workers"), [("50000 100000", 1), ("max 100000", None)])
def test_a_container_has_as_many_workers_as_its_quota_allows(tmp_path, monkeypatch, quota, workers):
    monkeypatch.delenv("STEER_WORKERS")
    (tmp_path / "cpu.max").write_text(f"{quota}\n")
    monkeypatch.setattr(executors, "CPU_MAX", tmp_path / "cpu.max")
    assert executors.default_workers() == (workers or executors.usable_cores())
    monkeypatch.delattr("os.sched_getaffinity", raising=False)  # as on macOS and Windows
    assert executors.usable_cores() == os.cpu_count()


def test_only_what_changed_is_made_again(folder, expected, monkeypatch):
    """Finished drives stay, although DVC deletes the output of a stage before it runs."""
    for drives, k, input_b, code, made in [
        (["a", "b"], 2, bytes(6), "1", ["a", "b"]),
        (["a", "b", "c"], 2, bytes(6), "1", ["c"]),  # a new drive
        (["a", "b", "c"], 2, b"other", "1", ["b"]),
        (["a", "b", "c"], 3, b"other", "1", ["a", "b", "c"]),
        (["a", "b"], 3, b"other", "2", ["a", "b"]),
        (DRIVES, 2, bytes(6), "2", DRIVES),
        (DRIVES, 2, bytes(6), "2", []),
    ]:
        shutil.rmtree(folder / "data/toy", ignore_errors=True)
        (folder / "input/b").write_bytes(input_b)
        monkeypatch.setattr(keys.Code, "hash", lambda self, code=code: code)
        toy_stage.main(folder, k=k, workers=1, drives=drives)
        assert calls(folder) == made
    assert outputs(folder) == expected
    kept = [path.name.split("-")[0] for path in (folder / "data/.drives/toy").iterdir()]
    assert sorted(kept) == DRIVES, "without the drives of other settings"


@pytest.mark.parametrize(
    ("kind", "workers"),
    [("fail", 1), pytest.param("die", 2, marks=pytest.mark.slow)],
)
def test_an_error_and_a_dead_worker_keep_finished_drives(folder, expected, kind, workers):
    trouble(folder, c=kind)
    with pytest.raises(InputError) as raised:
        toy_stage.main(folder, workers=workers)
    if kind == "fail":
        assert raised.value.where == "c: 0.png"
    else:
        assert "STEER_WORKERS=1" in raised.value.fix
    assert outputs(folder) == {}, "the stage's folder is filled at the end"
    trouble(folder)
    calls(folder)
    toy_stage.main(folder, workers=1)
    repeated = calls(folder)
    assert "c" in repeated
    assert "b" not in repeated or kind == "die"
    assert outputs(folder) == expected


@pytest.mark.slow
def test_an_edit_before_a_process_of_the_stage_starts_is_named(folder, monkeypatch):
    monkeypatch.setitem(keys.LOADED, "numpy", "before the edit")
    with pytest.raises(InputError, match="numpy: was edited while stage labels ran"):
        toy_stage.main(folder, workers=2)
    assert calls(folder) == []


def test_a_drive_that_another_worker_has_just_finished_is_taken(tmp_path):
    """A worker of a cluster ends its drive after the run was interrupted, and repeated."""
    finished = {"frames": 9}

    def work(path: Path) -> dict[str, Any]:
        write_text(path, "mine")
        write_text(tmp_path / "kept/a.h5", "of the other worker")
        write_text(tmp_path / "kept/summary.json", json.dumps(finished))
        return {"frames": 1}

    summary, _ = runner._make_result(runner.Task("a", tmp_path / "kept/a.h5", work))
    assert summary == finished
    assert (tmp_path / "kept/a.h5").read_text() == "of the other worker"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_run_keeps_finished_drives_and_leaves_no_process(folder, expected, number):
    trouble(folder, a="wait", c="wait")
    with start(folder) as process:
        paths = [folder / f"trouble/{drive} waits" for drive in "ac"]
        wait_for(lambda: all(path.exists() and path.read_text() for path in paths))
        pids = [int(path.read_text()) for path in paths]
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
    trouble(folder)
    calls(folder)
    toy_stage.main(folder, workers=1)
    assert "b" not in calls(folder)
    assert outputs(folder) == expected


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Start a scheduler and two workers."""
    distributed = pytest.importorskip("distributed")
    options = {"dashboard_address": "127.0.0.1:0", "host": "127.0.0.1", "processes": True}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, **options) as started:
        yield started


@pytest.fixture
def dask(cluster, monkeypatch) -> Any:
    monkeypatch.setenv(executors.SCHEDULER, cluster.scheduler_address)
    return cluster


@pytest.mark.slow
def test_a_worker_of_a_cluster_with_other_code_or_data_is_refused(folder, dask):
    import distributed

    with distributed.Client(dask, set_as_default=False) as client:
        client.wait_for_workers(2)  # an earlier test may have killed them
        # A file of pipeline/jobs is in no key, but workers need the same.
        for name in ("numpy", "pipeline/labels/label.py", "pipeline/jobs/runner.py"):
            client.run(toy_stage.pretend, name, "another")
            with pytest.raises(InputError, match="got another, expected") as raised:
                toy_stage.main(folder)
            client.run(toy_stage.pretend, name, keys.LOADED[name])
            assert raised.value.where == f"{name} of the worker on {socket.gethostname()}"
    assert calls(folder) == []

    stage = StageFolder(keys.Code.read("labels"), folder / "elsewhere/new", folder, set())
    with pytest.raises(InputError, match="data is the same as here"):
        next(executors.run_jobs(len, ["a", "b"], stage))


@pytest.mark.slow
def test_a_cluster_writes_the_bytes_of_one_process(folder, expected, dask):
    """A job of a dead worker is repeated."""
    trouble(folder, b="die once")
    toy_stage.main(folder)
    pids = {line.split()[1] for line in (folder / "calls").read_text().splitlines()}
    assert str(os.getpid()) not in pids
    assert outputs(folder) == expected


@pytest.mark.slow
def test_a_job_that_kills_workers_of_a_cluster_is_given_up(folder, dask, monkeypatch):
    """No test follows that needs workers: on a busy machine, they may not come back."""
    trouble(folder, b="die")
    monkeypatch.setattr(dask.scheduler, "allowed_failures", 1)
    with pytest.raises(InputError, match="a worker process died"):
        toy_stage.main(folder)


def test_without_a_scheduler_a_line_says_so(folder, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setenv(executors.SCHEDULER, "tcp://127.0.0.1:1")
    with pytest.raises(InputError, match=r"no scheduler answers at .*Start one: dask scheduler"):
        toy_stage.main(folder)


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (InputError("wrong:\n  value", "a", "Do b"), "a: wrong: value. Do b"),
        (OSError(errno.ENOSPC, "No space left", "data/x.h5"), "data/x.h5: No space left"),
        (KeyboardInterrupt(), "interrupted. Repeat the command"),
    ],
    ids=repr,
)
def test_errors_are_one_line_and_a_status(monkeypatch, error, line):
    def main() -> None:
        raise error

    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(SystemExit) as end:
        console.run(main)
    # Python prints it to stderr and exits with status 1.
    assert str(end.value.code).startswith(f"error: {line}")
