"""Make drives in parallel, and keep them for later runs.

A finished drive is a folder ``data/.drives/STAGE/DRIVE-KEY`` with its result and summary.json. The
key hashes everything that determines the drive, so a run makes only drives whose inputs, settings
or code have changed.
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

from pipeline.base.errors import error_context
from pipeline.base.executors import default_workers, run_jobs
from pipeline.base.outputs import StageFolder, link
from pipeline.base.resume import stage_key
from pipeline.base.store import replacing

Summary = dict[str, Any]


class Job(NamedTuple):
    """One drive of a stage."""

    drive: str  # unique in the stage
    target: str  # path of its file or folder in the stage's folder
    # files and strings that determine the content, with the stage's code and settings
    inputs: Sequence[Path | str]
    # picklable; writes the file or folder to a path, returns a JSON-able summary
    work: Callable[[Path], Summary]
    own: tuple[str, ...] = ()  # files of code that only such drives need, see Code.of


def file_jobs(
    drives: Iterable[str],
    inputs: Mapping[str, Path],
    work: Callable[..., Summary],
    target: str = "{}.h5",
) -> list[Job]:
    """Return the jobs that make `target` from the drives' files. `inputs`: argument of `work` →
    folder of a stage.
    """
    files = {
        drive: {name: folder / f"{drive}.h5" for name, folder in inputs.items()} for drive in drives
    }
    return [
        Job(drive, target.format(drive), [*of.values()], partial(work, **of))
        for drive, of in files.items()
    ]


def make_drives(
    folder: StageFolder,
    jobs: Sequence[Job],
    settings: BaseModel | Mapping[str, Any],
    describe: str,
    workers: int | None = None,
) -> dict[str, Summary]:
    """Make the drives that no earlier run made, add all to ``folder.new``, and return drive →
    summary, as in `jobs`.

    `settings`, a section or JSON-able, are part of every key, so without what determines single
    drives only. `describe` is the format of a summary for the log.
    """
    settings = settings.model_dump(mode="json") if isinstance(settings, BaseModel) else settings

    code = {own: folder.code.hash(own) for own in {job.own for job in jobs}}

    def result(job: Job) -> Path:
        key = stage_key(code[job.own], {"drive": job.drive, **settings}, job.inputs)
        return folder.kept / f"{job.drive}-{key}" / Path(job.target).name

    # hashing files releases Python's lock
    with ThreadPoolExecutor(workers or default_workers()) as pool:
        kept = dict(zip((job.drive for job in jobs), pool.map(result, jobs), strict=True))
    folder.used.update(path.parent for path in kept.values())
    todo = [job for job in jobs if not kept[job.drive].exists()]
    if len(todo) < len(jobs):
        print(f"{len(jobs) - len(todo)} of {len(jobs)} drives kept from earlier runs", flush=True)
    # Drives with the most data start first, so that all processes end at about the same time.
    todo.sort(
        key=lambda job: -sum(path.stat().st_size for path in job.inputs if isinstance(path, Path))
    )
    tasks = [(job.drive, kept[job.drive], job.work) for job in todo]
    for (drive, path, _), (summary, seconds) in run_jobs(
        _make, tasks, folder.code, workers=workers
    ):
        size = sum(file.stat().st_size for file in path.parent.rglob("*") if file.is_file())
        rate = f", {summary['frames'] / seconds:.1f} frames/s" if summary.get("frames") else ""
        print(
            f"{drive}: {describe.format_map(summary)}, {size / 1e6:.1f} MB, {seconds:.1f} s{rate}",
            flush=True,
        )
    for job in jobs:
        path, target = kept[job.drive], folder.new / job.target
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(path, target, copy_function=link) if path.is_dir() else link(path, target)
    summaries = {
        drive: json.loads((path.parent / "summary.json").read_text())
        for drive, path in kept.items()
    }
    if without := [drive for drive, summary in summaries.items() if summary.get("frames") == 0]:
        print(f"no frames of {', '.join(without)}")
    return summaries


def _make(task: tuple[str, Path, Callable[[Path], Summary]]) -> tuple[Summary, float]:
    """Make one drive, and its summary beside it; an error names the drive."""
    drive, path, work = task
    start = time.perf_counter()
    with error_context(drive), replacing(path.parent) as tmp:
        tmp.mkdir()
        summary = work(tmp / path.name)
        (tmp / "summary.json").write_text(json.dumps(summary))
    return summary, time.perf_counter() - start
