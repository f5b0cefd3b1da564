"""The two rules for output: a command writes a folder that is free, a stage also one that it wrote
before.
"""

import os
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

from filelock import FileLock, Timeout

from pipeline.base.errors import InputError
from pipeline.base.resume import UNDO, Code
from pipeline.base.store import INDEX, NO_LOCKS, read_json, replacing, write_json

_FIX = "Pass another --out, or move it away"


def check_free(path: Path) -> None:
    """Raise InputError unless the file or folder `path` does not exist, or is an empty folder."""
    if not _is_free(path):
        names = ", ".join(sorted(child.name for child in path.glob("*"))[:3])
        raise InputError("exists already" + f" and holds {names}" * bool(names), path, _FIX)


@contextmanager
def claimed(out: Path | None, stem: str, suffix: str = "") -> Iterator[Path]:
    """Yield `out`, which has to be free, or the first path of out/STEM, out/STEM-2, … that does not
    exist.

    That path is made at once, so that another process takes the next one, and removed if the block
    leaves it empty. `suffix`: of a file, for instance .html; empty for a folder. Raises InputError
    unless `out` is free.
    """
    if out is not None:
        check_free(out)
        yield out
        return
    numbered = (Path("out", stem + f"-{number}" * (number > 1) + suffix) for number in count(1))
    path = next(path for path in numbered if _make(path, is_file=bool(suffix)))
    try:
        yield path
    finally:
        if path.is_dir() and _is_free(path):
            path.rmdir()
        elif path.is_file() and not path.stat().st_size:
            path.unlink()


def _make(path: Path, *, is_file: bool) -> bool:
    """Make an empty file or folder; return False if something is there."""
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
    return not any(path.iterdir()) if path.is_dir() else not path.exists()


class StageFolder(NamedTuple):
    """Where a stage works while it runs."""

    code: Code  # of the stage, as this process loaded it
    new: Path  # empty; what the stage writes here becomes the content of its output folder
    # data/.drives/STAGE or data/.drives/STAGE-ENTRY, outside of all DVC outputs, for the next run
    kept: Path
    used: set[Path]  # children of `kept` that this run needs; a success removes all others


@contextmanager
def locked(folder: Path, path: str) -> Iterator[None]:
    """Hold the lock `path` of a folder. Raises InputError if another process does, or the file
    system has no locks.
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
    own: Collection[str] = (),
) -> Iterator[StageFolder]:
    """Hold the lock of the output folder `out`, and move there what the block writes, when it ends
    without error.

    `stage` is a name in ``dvc.yaml``; with an entry, ``graphs@NAME``, `out` is a folder in the
    stage's folder. `drives` are written to ``out/index.json``: drive → split for each DRIVE.h5, in
    order. `own`: see :meth:`Code.of`.

    Raises InputError if another process writes `out`, if `out` holds files that this stage did not
    write, or if the code or the sections of `params` were edited since the start, for which DVC
    would take the result.
    """
    name, _, entry = stage.partition("@")
    root = out.parent if entry else out
    kept = root.with_name(".drives") / (f"{root.name}-{out.name}" if entry else out.name)
    kept.mkdir(parents=True, exist_ok=True)
    index: dict[str, Any] = {} if drives is None else {"drives": dict(drives)}
    index |= {"stage": name, "entry": entry}
    with locked(out, f"{kept}.lock"):
        _check_owner(out, index)
        code = Code.of(name, own)
        sections = code.sections(params, entry)
        folder = StageFolder(code, kept / "new", kept, set())
        _remove(folder.new)
        folder.new.mkdir()
        yield folder

        code.check()
        for key, content in code.sections(params, entry).items():
            if content != sections[key]:
                raise InputError(f"{key} was edited while stage {stage} ran", params or "", UNDO)
        write_json(folder.new / INDEX, index, sort_keys=False)
        _move(folder.new, out)
        for path in set(kept.iterdir()) - folder.used:
            _remove(path)


def _check_owner(out: Path, index: Mapping[str, Any]) -> None:
    """Raise InputError if `out` holds files that the stage did not write. DVC empties it, and asks
    nobody.
    """
    if "DVC_STAGE" in os.environ or all(path.name.startswith(".") for path in out.glob("*")):
        return
    before = read_json(out / INDEX, stage=index["stage"]) if (out / INDEX).is_file() else {}
    if (before.get("stage"), before.get("entry")) != (index["stage"], index["entry"]):
        stage = "@".join(filter(None, (index["stage"], index["entry"])))
        raise InputError(f"folder has files that stage {stage} did not write", out, _FIX)


def _move(new: Path, out: Path) -> None:
    """Move the content of `new` to `out`; replace files of the same names, and remove drives of
    earlier runs.
    """
    out.mkdir(parents=True, exist_ok=True)
    _remove(out / INDEX)  # no stage reads the folder until this is there again, as the last file
    paths = sorted(new.iterdir(), key=lambda path: path.name == INDEX)
    for name in {path.name for path in (*out.glob("*.h5"), *paths)}:
        _remove(out / name)
    for path in paths:
        with replacing(out / path.name) as tmp:
            shutil.move(path, tmp)


def _remove(path: Path) -> None:
    """Remove a file or a folder, if there is one."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def link(path: str | Path, target: str | Path) -> None:
    """Hard-link a file; copy it if that fails, as between two disks."""
    try:
        os.link(path, target)
    except OSError:
        shutil.copyfile(path, target)
