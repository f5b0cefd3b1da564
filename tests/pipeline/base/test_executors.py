"""Where jobs run: threads of local processes, and the workers of a Dask cluster of this machine."""

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from pipeline.base import resume
from pipeline.base.errors import InputError
from pipeline.base.executors import SCHEDULER, run_jobs
from tests.pipeline.base import toy_stage
from tests.pipeline.base.toy_stage import calls, outputs, trouble

LOCAL = {"dashboard_address": "127.0.0.1:0", "host": "127.0.0.1"}


def threads(job: int) -> tuple[int, str | None]:
    return os.getpid(), os.environ.get("OMP_NUM_THREADS")


@pytest.mark.slow
def test_with_a_number_of_threads_one_job_runs_in_a_process_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the number of threads, which may change the last bits of a training, would depend on the workers."""
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    ((_, (process, used)),) = run_jobs(threads, [0], workers=1, threads=1)
    assert (process != os.getpid(), used) == (True, "1")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A scheduler and two workers."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, **LOCAL) as started:
        yield started


@pytest.fixture
def dask(cluster: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv(SCHEDULER, cluster.scheduler_address)
    return cluster


@pytest.mark.slow
def test_a_cluster_writes_the_bytes_of_one_process(
    folder: Path, expected: dict[str, bytes], dask: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    toy_stage.main(Path(), workers=None)
    assert outputs(folder) == expected
    processes = {line.split()[1] for line in (folder / "calls").read_text().splitlines()}
    assert str(os.getpid()) not in processes


@pytest.mark.slow
def test_a_job_whose_worker_dies_goes_to_another(folder: Path, expected: dict[str, bytes], dask: Any) -> None:
    trouble(folder, b="die once")
    toy_stage.main(folder)
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
def test_a_worker_with_other_code_is_refused(folder: Path, dask: Any) -> None:
    import distributed

    with distributed.Client(dask, set_as_default=False) as client:
        client.wait_for_workers(2)  # an earlier test may have killed them
        client.run(pretend, "0123456789")
        with pytest.raises(InputError, match="other code") as raised:
            toy_stage.main(folder)
        client.run(pretend, resume.code_hash())
    assert raised.value.where.startswith("worker tcp://")
    assert calls(folder) == []
