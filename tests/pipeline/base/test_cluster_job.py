"""What a worker of a cluster refuses before it does a job, each in one line."""

import os
import pickle
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import distributed
import pytest

from pipeline.base import cluster_job, progress, provenance
from pipeline.base.errors import InputError


@pytest.fixture(autouse=True)
def worker(monkeypatch: pytest.MonkeyPatch) -> Iterator[SimpleNamespace]:
    """This process as a worker of one thread, that goes back where it was."""
    worker = SimpleNamespace(address="tcp://node7:1", state=SimpleNamespace(nthreads=1))
    monkeypatch.setattr(distributed, "get_worker", lambda: worker)
    monkeypatch.setattr(distributed, "print", print)
    monkeypatch.chdir(Path.cwd())
    cluster_job._work.cache_clear()
    cluster_job._first_seen.cache_clear()
    yield worker
    progress.listen(progress.nobody)
    cluster_job._first_seen.cache_clear()


@pytest.fixture
def fit(tmp_path: Path) -> cluster_job.Run:
    (tmp_path / "stage.lock").write_text("71 node0")
    return cluster_job.Run(
        name="first",
        work=pickle.dumps("work"),
        folder=str(tmp_path),
        mark=("stage.lock", "71 node0"),
        modules=("stages.labels",),
        code=cluster_job.code(["stages.labels"]),
        versions=cluster_job.versions(),
        hint="start workers",
    )


def job(work: str) -> str:
    progress.advance(3)
    print("said")
    return f"{work} in {Path.cwd().name}"


def do(run: cluster_job.Run) -> tuple[str, int]:
    return cluster_job.do(run, pickle.dumps(job))


def test_a_fit_worker_works_where_the_stage_was_started(
    fit: cluster_job.Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert do(fit) == (f"work in {tmp_path.name}", 3)
    os.chdir("/")
    assert do(fit) == (f"work in {tmp_path.name}", 3)
    assert capsys.readouterr().out == "said\nsaid\n"


def test_two_runs_have_their_own_work(fit: cluster_job.Run, tmp_path: Path) -> None:
    other = replace(fit, name="second", work=pickle.dumps("other"))
    assert [do(run)[0].split()[0] for run in (fit, other, fit)] == ["work", "other", "work"]


def test_one_thread(fit: cluster_job.Run, worker: SimpleNamespace) -> None:
    worker.state.nthreads = 4
    with pytest.raises(InputError, match=r"^worker tcp://node7:1 has 4 threads, and may have one: start workers$"):
        do(fit)


def test_the_same_libraries(fit: cluster_job.Run) -> None:
    own = fit.versions
    other = replace(fit, versions=own | {"numpy": "1.0", "Python": "3.9.1"})
    wrong = rf"has Python {own['Python']} instead of 3\.9\.1, numpy {own['numpy']} instead of 1\.0: start workers$"
    with pytest.raises(InputError, match=wrong):
        do(other)


def test_the_same_code(fit: cluster_job.Run) -> None:
    with pytest.raises(InputError, match=r"runs another version of the code of stages\.labels, in .*: end it, and "):
        do(replace(fit, code="another"))


def test_code_counts_as_this_process_saw_it_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    (tmp_path / "pipeline").mkdir()
    for name in ("a", "b"):
        (tmp_path / f"pipeline/{name}.py").write_text("import pipeline.c\n")
    (tmp_path / "pipeline/c.py").write_text("c = 1\n")
    first = cluster_job.code(["pipeline.a"])
    (tmp_path / "pipeline/c.py").write_text("c = 2\n")  # by somebody who goes on with b
    assert cluster_job.code(["pipeline.a"]) == first
    stale = cluster_job.code(["pipeline.b"])
    cluster_job._first_seen.cache_clear()
    assert cluster_job.code(["pipeline.b"]) != stale, "a process that began later is up to date"


def test_the_same_files(fit: cluster_job.Run, tmp_path: Path) -> None:
    unseen = r"^worker tcp://node7:1 does not see the same files in {}: code and data must lie .*docs/cluster\.md\)$"
    with pytest.raises(InputError, match=unseen.format("/nowhere")):
        do(replace(fit, folder="/nowhere"))
    for mark in (("stage.lock", "72 node0"), ("other.lock", "71 node0")):
        with pytest.raises(InputError, match=unseen.format(tmp_path)):
            do(replace(fit, mark=mark))
