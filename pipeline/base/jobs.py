"""Jobs that make drives, in this process or in several: what each drive needs next is known by a generator."""

from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, NamedTuple

from tqdm import tqdm

from pipeline.base.console import default_workers
from pipeline.base.errors import InputError
from pipeline.base.processes import BROKEN, processes, with_work

REFRESH_S = 0.5  # of the bar, while workers count
Summary = dict[str, Any]


class Job(NamedTuple):
    """``call(work)`` is done in any process; errors that end a process name `where`."""

    where: str
    call: Callable[[Any], Any]


Steps = Generator[list[Job], list[Any], tuple[Summary, float]]
"""How a drive is made: yields jobs to be done in any order, is sent what they return, returns summary and seconds."""
Finish = Callable[[str, Summary, float], None]
"""Called with drive, summary and seconds of work, when a drive is made."""


def run_alone(makers: Mapping[str, Steps], work: Any, finish: Finish) -> None:
    """Do all jobs in this process, drive by drive."""
    for drive, steps in makers.items():
        finish(drive, *_run(steps, work))


def _run(steps: Steps, work: Any) -> tuple[Summary, float]:
    try:
        jobs = next(steps)
        while True:
            jobs = steps.send([job.call(work) for job in jobs])
    except StopIteration as end:
        made: tuple[Summary, float] = end.value
        return made


class _Step:
    """Jobs of a drive that may be done in any order, and what they have returned."""

    def __init__(self, drive: str, jobs: Sequence[Job]) -> None:
        self.drive, self.jobs = drive, jobs
        self.results: dict[int, Any] = {}

    @property
    def is_done(self) -> bool:
        return len(self.results) == len(self.jobs)


def run_in_processes(
    makers: Mapping[str, Steps], work: Any, workers: int, finish: Finish, bar: tqdm, by_frame: bool
) -> None:
    """Do the jobs in so many processes; each has a copy of `work`.

    Raises the first error of a job after those that run are done; the jobs that wait are left out.
    """
    queue: deque[tuple[_Step, int]] = deque()
    pending: dict[Future[Any], tuple[_Step, int]] = {}
    unstarted, failures = iter(makers), list[Exception]()

    def go_on(drive: str, results: list[Any] | None) -> None:
        """Put the jobs of a drive's next step, or of the first, in front: few drives are unfinished at a time."""
        try:
            step = _Step(drive, makers[drive].send(results))  # type: ignore[arg-type]  # None starts it
        except StopIteration as end:
            finish(drive, *end.value)
            return
        queue.extendleft((step, number) for number in reversed(range(len(step.jobs))))
        if not step.jobs:
            go_on(drive, [])

    def submit() -> None:
        while len(pending) < 2 * workers and not failures:  # one more each, so that nobody waits for this process
            while not queue and (drive := next(unstarted, None)) is not None:
                go_on(drive, None)
            if not queue:
                break
            step, number = queue.popleft()
            job = step.jobs[number]
            try:
                pending[pool.submit(with_work, job.call)] = step, number
            except BrokenProcessPool:  # just now, before any job says so
                failures.append(InputError(BROKEN.format(where=job.where)))

    def settle(job: Future[Any]) -> None:
        step, number = pending.pop(job)
        try:
            step.results[number] = job.result()
            if step.is_done:
                go_on(step.drive, [step.results[number] for number in range(len(step.jobs))])
        except BrokenProcessPool:
            failures.append(InputError(BROKEN.format(where=step.jobs[number].where)))
        except Exception as error:  # whatever it is, the other work is worth keeping
            failures.append(error)

    with processes(workers, max(1, default_workers() // workers), work) as (pool, done_frames):
        try:
            submit()
            while pending:
                done, _ = wait(pending, None if bar.disable else REFRESH_S, return_when=FIRST_COMPLETED)
                if by_frame:
                    bar.update(done_frames.value - bar.n)
                for job in done:
                    settle(job)
                if failures:
                    for job in [job for job in pending if job.cancel()]:
                        del pending[job]
                submit()
        finally:  # after Ctrl-C too: leaving the pool waits for what is not cancelled
            for job in pending:
                job.cancel()
    if failures:
        raise failures[0]
