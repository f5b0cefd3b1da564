"""Whatever ends a run, finished drives are kept and no file is half-written; here, in processes and on a cluster."""

import errno
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from pipeline.base import console, resume
from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.executors import SCHEDULER
from pipeline.base.resume import ROOT, stage_key
from tests.pipeline.base import toy_stage
from tests.pipeline.base.toy_stage import DRIVES, alive, calls, outputs, start, trouble, wait_for


@pytest.fixture
def folder(tmp_path) -> Path:
    return toy_stage.prepare(tmp_path)


@pytest.fixture(scope="module")
def expected(tmp_path_factory) -> dict[str, bytes]:
    """The files that one process writes."""
    folder = toy_stage.prepare(tmp_path_factory.mktemp("serial"))
    toy_stage.main(folder, workers=1)
    return outputs(folder)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_bytes_do_not_depend_on_workers(folder, expected, workers, capsys):
    summaries = toy_stage.main(folder, workers=workers)
    assert list(summaries.items()) == [(drive, {"frames": toy_stage.FRAMES[drive]}) for drive in DRIVES]
    assert outputs(folder) == expected
    assert calls(folder) == DRIVES
    lines = capsys.readouterr().out.splitlines()
    assert {line.split(",")[0] for line in lines} == {f"{name}: {n} frames" for name, n in toy_stage.FRAMES.items()}
    if workers == 1:
        assert [line.split(":")[0] for line in lines] == ["b", "c", "a", "empty"], "the longest first"


def test_only_what_changed_is_made_again(folder, expected):
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


@pytest.mark.parametrize(
    ("kind", "workers"), [("fail", 1), *(pytest.param(kind, 2, marks=pytest.mark.slow) for kind in ("die", "full"))]
)
def test_an_error_a_dead_worker_and_a_full_disk_keep_finished_drives(folder, expected, kind, workers):
    trouble(folder, c=kind)
    with pytest.raises((InputError, OSError)) as raised:
        toy_stage.main(folder, workers=workers)
    match raised.value:
        case DamagedFile() as error:
            assert error.where == "c: 0.png"
        case InputError() as error:
            assert "STEER_WORKERS=1" in error.fix
        case OSError() as error:
            assert error.errno == errno.EFBIG
            assert error.filename.endswith("c.h5")
    assert outputs(folder) == {}, "the stage's folder is filled at the end"
    trouble(folder)
    calls(folder)
    toy_stage.main(folder, workers=1)
    assert "c" in (repeated := calls(folder))
    assert "b" not in repeated or kind == "die"
    assert outputs(folder) == expected


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
    """A scheduler and two workers."""
    distributed = pytest.importorskip("distributed")
    local = {"dashboard_address": "127.0.0.1:0", "host": "127.0.0.1"}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, **local) as started:
        yield started


@pytest.fixture
def dask(cluster, monkeypatch) -> Any:
    monkeypatch.setenv(SCHEDULER, cluster.scheduler_address)
    return cluster


@pytest.mark.slow
def test_a_cluster_writes_the_bytes_of_one_process_and_repeats_jobs_of_dead_workers(folder, expected, dask):
    trouble(folder, b="die once")
    toy_stage.main(folder)
    assert str(os.getpid()) not in (folder / "calls").read_text().split()
    assert calls(folder).count("b") == 2
    assert outputs(folder) == expected
    dask.scheduler.allowed_failures, before = 0, dask.scheduler.allowed_failures
    trouble(folder, b="die")
    with pytest.raises(InputError, match="died"):
        toy_stage.main(folder, k=3)
    dask.scheduler.allowed_failures = before


def pretend(code: str) -> None:
    resume.code_hash = partial(str, code)  # type: ignore[assignment]


@pytest.mark.slow
def test_a_worker_with_other_code_is_refused(folder, dask):
    import distributed

    with distributed.Client(dask, set_as_default=False) as client:
        client.wait_for_workers(2)  # an earlier test may have killed them
        client.run(pretend, "0123456789")
        with pytest.raises(InputError, match="other code") as raised:
            toy_stage.main(folder)
        client.run(pretend, resume.code_hash())
    assert raised.value.where.startswith("worker tcp://")
    assert calls(folder) == []


@pytest.mark.parametrize(
    ("file", "stages"),
    [
        ("pipeline/labels/label.py", {"labels", "train"}),
        ("pipeline/base/store.py", {"labels", "clouds", "train"}),
        ("models/steering/spatial/gnn.py", {"train"}),  # a file that dvc.yaml names by ${item.spatial}
        ("pipeline/sample/world.py", set()),
    ],
)
def test_the_code_that_dvc_yaml_names_is_in_a_key(monkeypatch, file, stages):
    def keys(edited: str) -> dict[str, str]:
        monkeypatch.setattr(resume, "file_hash", lambda path: f"{path} {path == ROOT / edited}")
        resume._stage_code_hash.cache_clear()  # as in a new process
        return {stage: stage_key(stage, {}, []) for stage in ("labels", "clouds", "train")}

    before = keys("")
    assert {stage for stage, key in keys(file).items() if key != before[stage]} == stages
    resume._stage_code_hash.cache_clear()


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (InputError("wrong:\n  value", "a", "Do b"), "a: wrong: value. Do b"),
        (OSError(errno.ENOSPC, "No space left", "data/x.h5"), "data/x.h5: No space left"),
        (KeyboardInterrupt(), "interrupted. Repeat the command to continue: complete files are kept"),
    ],
    ids=repr,
)
def test_errors_are_one_line_and_a_status(monkeypatch, error, line):
    def main() -> None:
        raise error

    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(SystemExit) as end:
        console.run(main)
    assert end.value.code == f"error: {line}"  # Python prints it to stderr and exits with status 1
