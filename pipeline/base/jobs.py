"""Jobs that make drives, in this process or by others: what each drive needs next is known by a generator."""

from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any, NamedTuple, Protocol

from tqdm import tqdm

from pipeline.base.errors import InputError

REFRESH_S = 0.5  # of the bar, while workers count
Summary = dict[str, Any]


class Job(NamedTuple):
    """``call(work)`` is done in any process; errors that end a process name `where`."""

    where: str
    call: Callable[[Any], Any]


class Workers(Protocol):
    """Who does jobs: processes of this machine, or of others. Each has a copy of the work."""

    @property
    def count(self) -> int:
        """How many jobs they do at a time."""

    @property
    def done_frames(self) -> int:
        """How many frames their jobs have told of."""

    def submit(self, job: Job) -> Future[Any]:
        """Have a job done. Raises InputError if there is nobody left."""

    def result(self, future: Future[Any], where: str) -> Any:
        """Return what a job that has ended returned, or raise what it raised; InputError if who did it is gone."""


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


def run_by(workers: Workers, makers: Mapping[str, Steps], finish: Finish, bar: tqdm, by_frame: bool) -> None:
    """Have the jobs done by others.

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
        most = 0 if failures else 2 * max(1, workers.count)  # one more each, so that nobody waits for this process
        while len(pending) < most and not failures:
            while not queue and (drive := next(unstarted, None)) is not None:
                go_on(drive, None)
            if not queue:
                break
            step, number = queue.popleft()
            try:
                pending[workers.submit(step.jobs[number])] = step, number
            except InputError as error:
                failures.append(error)

    def settle(job: Future[Any]) -> None:
        step, number = pending.pop(job)
        try:
            step.results[number] = workers.result(job, step.jobs[number].where)
            if step.is_done:
                go_on(step.drive, [step.results[number] for number in range(len(step.jobs))])
        except Exception as error:  # whatever it is, the other work is worth keeping
            failures.append(error)

    try:
        submit()
        while pending:
            done, _ = wait(pending, None if bar.disable else REFRESH_S, return_when=FIRST_COMPLETED)
            for job in done:
                settle(job)
            if by_frame:
                bar.update(workers.done_frames - bar.n)
            if failures:
                for job in [job for job in pending if job.cancel()]:
                    del pending[job]
            submit()
    finally:  # after Ctrl-C too: leaving the workers waits for what is not cancelled
        for job in pending:
            job.cancel()
    if failures:
        raise failures[0]
