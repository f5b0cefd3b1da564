"""Protect existing files: a command writes to a free folder, a stage also to its earlier output."""

import os
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple
from uuid import uuid4

from filelock import FileLock, Timeout

from pipeline.jobs.keys import UNDO, Code, read_sections, scan_code

from pipeline.base.errors import InputError
from pipeline.base.store import INDEX, naming_full_disk, replacing, write_index

# Advice for an output folder that is not free.
_FIX = "Choose another name for the output, or move it away"


def check_free(path: Path) -> None:
    """Raise InputError unless the file or folder `path` does not exist, or is an empty folder."""
    names = sorted(child.name for child in path.glob("*"))
    if names:
        raise InputError(f"exists already and holds {', '.join(names[:3])}", path, _FIX)
    if path.exists() and not path.is_dir():
        raise InputError("exists already", path, _FIX)


def find_free(out: Path | None, stem: str, suffix: str) -> Path:
    """Return the file `out`, or for None the first of the default paths that does not exist.

    `suffix` is that of the file, for instance .html. Raises InputError unless `out` is free.
    """
    if out is not None:
        check_free(out)
        return out
    return next(path for path in _default_paths(stem, suffix) if not path.exists())


@contextmanager
def free_folder(out: Path | None, stem: str) -> Iterator[Path]:
    """Yield the folder `out`, or for None the first of the default paths that does not exist.

    The latter is made at once, so that a command that runs at the same time takes the next path. It
    is removed if the block fails and leaves it empty. Raises InputError unless `out` is free.
    """
    if out is not None:
        check_free(out)
        yield out
        return
    Path("out").mkdir(exist_ok=True)
    folder = next(path for path in _default_paths(stem) if _make_folder(path))
    try:
        yield folder
    finally:
        # A folder with results is not empty, so it stays.
        with suppress(OSError):
            folder.rmdir()


def _default_paths(stem: str, suffix: str = "") -> Iterator[Path]:
    """Yield out/STEM, out/STEM-2, out/STEM-3, …, each with the suffix."""
    yield Path("out", f"{stem}{suffix}")
    for number in count(2):
        yield Path("out", f"{stem}-{number}{suffix}")


def _make_folder(path: Path) -> bool:
    """Make a folder, and return whether nothing else had the path."""
    try:
        path.mkdir()
    except FileExistsError:
        return False
    return True


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
def hold_lock(folder: Path, path: str) -> Iterator[None]:
    """Hold the lock `path` of a folder.

    Raises InputError if another process holds it, or if it cannot be locked.
    """
    try:
        lock = FileLock(path, fallback_to_soft=False).acquire(timeout=0)
    except Timeout:
        fix = "Wait for that to end, then repeat the command"
        raise InputError("another process is writing it", folder, fix) from None
    except OSError as error:
        fix = "Move the checkout to a disk that has locks"
        raise InputError(f"cannot be locked ({error.strerror})", path, fix) from error
    with lock:
        yield


@contextmanager
def stage_folder(
    stage: str,
    out: Path,
    drives: Mapping[str, str] = MappingProxyType({}),
    *,
    params: Path | None = None,
    chosen: Collection[str] = (),
) -> Iterator[StageFolder]:
    """Yield a folder for a stage to write, and move its files to `out` if the block succeeds.

    `stage` is a name in ``dvc.yaml``. A stage with entries is named with its entry, as in
    ``graphs@NAME``, and its `out` is a folder in the stage's folder. `drives` maps each DRIVE.h5
    that the block writes to its split; it is written to ``out/index.json`` in this order. `chosen`
    is an argument of :meth:`Code.read`.

    Raises InputError if another process writes `out`, or if `out` holds files that no stage wrote.
    Raises it also if the code or the sections of `params` were edited since the start, as DVC would
    take the result for one of the edited files.
    """
    name, _, entry = stage.partition("@")
    kept = out.with_name(".drives") / out.name
    if entry:
        kept = out.parent.with_name(".drives") / f"{out.parent.name}-{out.name}"
    kept.mkdir(parents=True, exist_ok=True)

    with hold_lock(out, f"{kept}.lock"), naming_full_disk(out):
        # DVC has removed the stage's own files; those of others may lie beside them.
        if "DVC_STAGE" not in os.environ and not (out / INDEX).is_file():
            check_free(out)
        code = Code.read(name, chosen)
        sections = read_sections(name, params, entry)
        for path in kept.glob("new-*"):
            remove_path(path)
        folder = StageFolder(code, new=kept / f"new-{uuid4().hex}", kept=kept, used=set())
        folder.new.mkdir()
        yield folder

        code.check_unedited(scan_code())
        for key, content in read_sections(name, params, entry).items():
            if content != sections[key]:
                raise InputError(f"{key} was edited while stage {stage} ran", params or "", UNDO)
        write_index(folder.new, drives)
        _move_files(folder.new, out)
        for path in set(kept.iterdir()) - folder.used:
            remove_path(path)


def _move_files(new: Path, out: Path) -> None:
    """Move the content of `new` to `out`, and remove drives of earlier runs from there."""
    out.mkdir(parents=True, exist_ok=True)
    # Stages read no folder without an index, so it is removed first, and moved last.
    remove_path(out / INDEX)
    paths = sorted(new.iterdir(), key=lambda path: path.name == INDEX)

    earlier = [*out.glob("*.h5"), *(out / path.name for path in paths)]
    for path in earlier:
        remove_path(path)
    for path in paths:
        with replacing(out / path.name) as unfinished:
            shutil.move(path, unfinished)


def remove_path(path: Path) -> None:
    """Remove a file or a folder, if there is one."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def link_or_copy(path: str | Path, target: str | Path) -> None:
    """Make a hard link to a file, or a copy if a link is impossible, as between two disks."""
    try:
        os.link(path, target)
    except OSError:
        shutil.copyfile(path, target)
