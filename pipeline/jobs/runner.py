"""Make drives in parallel, and keep them for later runs.

A finished drive is a folder ``data/.drives/STAGE/DRIVE-KEY`` with its result and summary.json. The
key (:mod:`pipeline.jobs.keys`) hashes everything that determines the drive, so a run makes only
drives whose inputs, settings or code have changed.
"""

import json
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel

from pipeline.jobs.executors import default_workers, run_jobs
from pipeline.jobs.keys import stage_key
from pipeline.jobs.outputs import StageFolder, link_or_copy

from pipeline.base.errors import error_context
from pipeline.base.store import replacing
from pipeline.base.summary import Summary


class Job(NamedTuple):
    """The work of a stage on one drive."""

    # Name that is unique in the stage.
    drive: str
    # Path of the drive's file or folder in the stage's folder.
    target: str
    # Files and strings that determine the content, together with the stage's code and settings.
    inputs: Sequence[Path | str]
    # Picklable function that writes the file or folder to a path and returns a JSON-able summary.
    work: Callable[[Path], Summary]


class Task(NamedTuple):
    """A job that no earlier run has finished."""

    drive: str
    # Path that `work` will write.
    result: Path
    work: Callable[[Path], Summary]


def file_jobs(
    drives: Iterable[str],
    inputs: Mapping[str, Path],
    work: Callable[..., Summary],
    target: str = "{}.h5",
) -> list[Job]:
    """Return the jobs that make `target` of each drive from the drive's files of other stages.

    `inputs` maps an argument of `work` to the folder of the stage whose file it gets. ``{}`` in
    `target` stands for the drive.
    """
    jobs = []
    for drive in drives:
        files = {name: folder / f"{drive}.h5" for name, folder in inputs.items()}
        jobs.append(Job(drive, target.format(drive), [*files.values()], partial(work, **files)))
    return jobs


def make_drives(
    folder: StageFolder,
    jobs: Sequence[Job],
    settings: BaseModel | Mapping[str, Any],
    log_format: str,
    workers: int | None = None,
) -> dict[str, Summary]:
    """Make the drives that no earlier run made, and add all to ``folder.new``.

    `settings`, which are a section or JSON-able, are part of the key of every drive. A value that
    affects only some of the drives belongs to the inputs of their jobs instead. `log_format`
    formats the summary of a drive for the log.

    Returns drive → summary, in the order of `jobs`.
    """
    if isinstance(settings, BaseModel):
        settings = settings.model_dump(mode="json")
    results = _find_results(folder, jobs, settings, workers)
    folder.used.update(path.parent for path in results.values())

    todo = [job for job in jobs if not results[job.drive].exists()]
    if len(todo) < len(jobs):
        print(f"{len(jobs) - len(todo)} of {len(jobs)} drives kept from earlier runs", flush=True)

    # Drives with the most data start first, so that all processes end at about the same time.
    todo.sort(key=_input_bytes, reverse=True)
    tasks = [Task(job.drive, results[job.drive], job.work) for job in todo]
    for task, (summary, seconds) in run_jobs(_make_result, tasks, folder, workers=workers):
        files = [path for path in task.result.parent.rglob("*") if path.is_file()]
        megabytes = sum(file.stat().st_size for file in files) / 1e6
        text = f"{log_format.format_map(summary)}, {megabytes:.1f} MB, {seconds:.1f} s"
        if summary.get("frames"):
            text += f", {summary['frames'] / seconds:.1f} frames/s"
        print(f"{task.drive}: {text}", flush=True)

    summaries = {}
    for job in jobs:
        result = results[job.drive]
        _link_result(result, folder.new / job.target)
        summaries[job.drive] = json.loads((result.parent / "summary.json").read_text())
    empty = [drive for drive, summary in summaries.items() if summary.get("frames") == 0]
    if empty:
        print(f"no frames of {', '.join(empty)}")
    return summaries


def _find_results(
    folder: StageFolder, jobs: Sequence[Job], settings: Mapping[str, Any], workers: int | None
) -> dict[str, Path]:
    """Return drive → path of its result, which exists if an earlier run made it with this key."""
    code = folder.code.hash()

    def find_result(job: Job) -> Path:
        key = stage_key(code, {"drive": job.drive, **settings}, job.inputs)
        return folder.kept / f"{job.drive}-{key}" / Path(job.target).name

    # Threads are enough, as hashing files releases Python's lock.
    with ThreadPoolExecutor(workers or default_workers()) as pool:
        paths = pool.map(find_result, jobs)
        return {job.drive: path for job, path in zip(jobs, paths, strict=True)}


def _input_bytes(job: Job) -> int:
    return sum(path.stat().st_size for path in job.inputs if isinstance(path, Path))


def _make_result(task: Task) -> tuple[Summary, float]:
    """Make the result of a drive, and write its summary beside it.

    Returns the summary, and the time in seconds. Raises InputError with the name of the drive.
    """
    start = time.perf_counter()
    try:
        with error_context(task.drive), replacing(task.result.parent) as unfinished:
            unfinished.mkdir()
            summary = task.work(unfinished / task.result.name)
            (unfinished / "summary.json").write_text(json.dumps(summary))
    except OSError:
        # A worker of a cluster may just have finished this drive for an interrupted run.
        if not task.result.exists():
            raise
        summary = json.loads((task.result.parent / "summary.json").read_text())
    return summary, time.perf_counter() - start


def _link_result(result: Path, target: Path) -> None:
    """Link a kept file, or the files of a kept folder, to a place in the stage's folder."""
    target.parent.mkdir(parents=True, exist_ok=True)
    if result.is_dir():
        shutil.copytree(result, target, copy_function=link_or_copy)
    else:
        link_or_copy(result, target)
