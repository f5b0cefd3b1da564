"""Protect existing files: a command writes to a free folder, a stage also to its earlier output."""

import os
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from uuid import uuid4

from filelock import FileLock, Timeout

from pipeline.base.errors import InputError
from pipeline.base.keys import UNDO, Code, read_sections
from pipeline.base.store import INDEX, NO_LOCKS, read_json, replacing, write_json

# Advice for an output folder that is not free.
_FIX = "Choose another name for the output, or move it away"


def check_free(path: Path) -> None:
    """Raise InputError unless the file or folder `path` does not exist, or is an empty folder."""
    if _is_free(path):
        return
    problem = "exists already"
    names = sorted(child.name for child in path.glob("*"))
    if names:
        problem += f" and holds {', '.join(names[:3])}"
    raise InputError(problem, path, _FIX)


@contextmanager
def claimed(out: Path | None, stem: str, suffix: str = "") -> Iterator[Path]:
    """Yield `out`, or for None the first path of out/STEM, out/STEM-2, … that does not exist.

    The path is created at once, so that another process takes the next one. It is removed if the
    block leaves it empty. `suffix` is the suffix of a file, for instance .html, or empty for a
    folder. Raises InputError unless `out` is free.
    """
    if out is not None:
        check_free(out)
        yield out
        return
    path = Path("out", f"{stem}{suffix}")
    number = 1
    while not _make_empty(path, is_file=bool(suffix)):
        number += 1
        path = Path("out", f"{stem}-{number}{suffix}")
    try:
        yield path
    finally:
        if path.is_dir() and _is_free(path):
            path.rmdir()
        elif path.is_file() and not path.stat().st_size:
            path.unlink()


def _make_empty(path: Path, *, is_file: bool) -> bool:
    """Make an empty file or folder. Return False if the path exists already."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        if is_file:
            path.touch(exist_ok=False)
        else:
            path.mkdir()
    except FileExistsError:
        return False
    return True


def _is_free(path: Path) -> bool:
    if path.is_dir():
        return not any(path.iterdir())
    return not path.exists()


class StageFolder(NamedTuple):
    """The code and the folders of a stage that runs."""

    # The code of the stage, as this process loaded it.
    code: Code
    # A folder that is empty at first, and has a name of its own, as a worker of an earlier run may
    # still write to that of its run. Its files become the content of the stage's output folder.
    new: Path
    # The folder of files for the next run, outside of all DVC outputs: data/.drives/STAGE, or
    # data/.drives/STAGE-ENTRY.
    kept: Path
    # Children of `kept` that this run needs. If the stage succeeds, all others are removed.
    used: set[Path]


@contextmanager
def locked(folder: Path, path: str) -> Iterator[None]:
    """Hold the lock `path` of a folder.

    Raises InputError if another process holds it, or if the file system has no locks.
    """
    try:
        lock = FileLock(path, fallback_to_soft=False).acquire(timeout=0)
    except Timeout:
        fix = "Wait for that to end, then repeat the command"
        raise InputError("another process is writing it", folder, fix) from None
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
        fix = "Mount it with locks, or move the checkout to another disk"
        raise InputError("the file system has no locks", path, fix) from error
    with lock:
        yield


@contextmanager
def stage_folder(
    stage: str,
    out: Path,
    drives: Mapping[str, str] | None = None,
    *,
    params: Path | None = None,
    chosen: Collection[str] = (),
) -> Iterator[StageFolder]:
    """Yield a folder for a stage to write, and move its files to `out` if the block succeeds.

    `stage` is a name in ``dvc.yaml``. A stage with entries is named with its entry, as in
    ``graphs@NAME``, and its `out` is a folder in the stage's folder. `drives` maps each DRIVE.h5
    that the block writes to its split; it is written to ``out/index.json`` in this order. `chosen`
    is an argument of :meth:`Code.read`.

    Raises InputError if another process writes `out`, or if `out` holds files that this stage did
    not write. Raises it also if the code or the sections of `params` were edited since the start,
    as DVC would take the result for one of the edited files.
    """
    name, _, entry = stage.partition("@")
    kept = out.with_name(".drives") / out.name
    if entry:
        kept = out.parent.with_name(".drives") / f"{out.parent.name}-{out.name}"
    kept.mkdir(parents=True, exist_ok=True)

    index: dict[str, Any] = {}
    if drives is not None:
        index["drives"] = dict(drives)
    index["stage"] = name
    index["entry"] = entry

    with locked(out, f"{kept}.lock"):
        _check_owner(out, stage, index)
        code = Code.read(name, chosen)
        sections = read_sections(name, params, entry)
        for path in kept.glob("new-*"):
            remove(path)
        folder = StageFolder(code, kept / f"new-{uuid4().hex}", kept, set())
        folder.new.mkdir()
        yield folder

        code.check_unedited()
        for key, content in read_sections(name, params, entry).items():
            if content != sections[key]:
                raise InputError(f"{key} was edited while stage {stage} ran", params or "", UNDO)
        write_json(folder.new / INDEX, index, sort_keys=False)
        _move(folder.new, out)
        for path in set(kept.iterdir()) - folder.used:
            remove(path)


def _check_owner(out: Path, stage: str, index: Mapping[str, Any]) -> None:
    """Raise InputError if `out` holds files that the stage did not write.

    `index` is what the stage will write to ``out/index.json``.
    """
    # DVC empties the folder before it runs a stage, so there is nothing to protect.
    if "DVC_STAGE" in os.environ:
        return
    if all(path.name.startswith(".") for path in out.glob("*")):
        return
    if (out / INDEX).is_file():
        before = read_json(out / INDEX, stage=index["stage"])
        if all(before.get(key) == index[key] for key in ("stage", "entry")):
            return
    raise InputError(f"folder has files that stage {stage} did not write", out, _FIX)


def _move(new: Path, out: Path) -> None:
    """Move the content of `new` to `out`, and remove drives of earlier runs from there."""
    out.mkdir(parents=True, exist_ok=True)
    # Stages read no folder without an index, so it is removed first, and moved last.
    remove(out / INDEX)
    paths = sorted(new.iterdir(), key=lambda path: path.name == INDEX)

    earlier = [*out.glob("*.h5"), *(out / path.name for path in paths)]
    for path in earlier:
        remove(path)
    for path in paths:
        with replacing(out / path.name) as unfinished:
            shutil.move(path, unfinished)


def remove(path: Path) -> None:
    """Remove a file or a folder, if there is one."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def link(path: str | Path, target: str | Path) -> None:
    """Make a hard link to a file, or a copy if a link is impossible, as between two disks."""
    try:
        os.link(path, target)
    except OSError:
        shutil.copyfile(path, target)
