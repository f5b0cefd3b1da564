"""The two rules for output. A command writes a folder that is free; a stage replaces the files of its index."""

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

from filelock import FileLock, Timeout

from pipeline.base.errors import InputError
from pipeline.base.store import INDEX, NO_LOCKS, read_json, replacing, write_json

_FIX = "Pass another --out, or move it away"


def check_free(path: Path) -> None:
    """Raise InputError unless the file or folder `path` does not exist, or is an empty folder."""
    if not _is_free(path):
        names = ", ".join(sorted(child.name for child in path.glob("*"))[:3])
        raise InputError("exists already" + f" and holds {names}" * bool(names), path, _FIX)


def claim(out: Path | None, stem: str, suffix: str = "") -> Path:
    """Return `out`, or the first free path of out/STEM, out/STEM-2, …. Raises InputError unless `out` is free.

    `suffix`: of a file, for instance .html; empty for a folder.
    """
    if out is not None:
        check_free(out)
        return out
    numbered = (Path("out", stem + f"-{number}" * (number > 1) + suffix) for number in count(1))
    return next(path for path in numbered if _is_free(path))


def _is_free(path: Path) -> bool:
    return not any(path.iterdir()) if path.is_dir() else not path.exists()


class StageFolder(NamedTuple):
    """Where a stage works while it runs."""

    stage: str  # its name in dvc.yaml
    new: Path  # empty; what the stage writes here becomes the content of its output folder
    kept: Path  # data/.drives/STAGE or data/.drives/STAGE-ENTRY, outside of all DVC outputs, for the next run
    used: set[Path]  # children of `kept` that this run needs; a success removes all others


@contextmanager
def locked(folder: Path, path: str) -> Iterator[None]:
    """Hold the lock `path` of a folder. Raises InputError if another process does, or the file system has no locks."""
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
    stage: str, out: Path, drives: Mapping[str, str] | None = None, *, shared: bool = False
) -> Iterator[StageFolder]:
    """Hold the lock of the output folder `out`, and publish what the block writes when it ends without error.

    The files in ``StageFolder.new`` replace those that an earlier run listed in ``out/index.json``. The new index also
    has `drives`, drive → split for each DRIVE.h5, in order. `stage` is a name in ``dvc.yaml``; with an entry,
    ``graphs@NAME``, `out` is a folder in the stage's folder. If `shared`, `out` may hold other files.

    Raises InputError if another process writes `out`, or if `out` holds files that this stage did not write.
    """
    name, _, entry = stage.partition("@")
    root = out.parent if entry else out
    kept = root.with_name(".drives") / (f"{root.name}-{out.name}" if entry else out.name)
    kept.mkdir(parents=True, exist_ok=True)
    with locked(out, f"{kept}.lock"):
        owner = {"stage": name, "entry": entry}
        before = _own_files(out, owner, shared)
        folder = StageFolder(name, kept / "new", kept, set())
        shutil.rmtree(folder.new, ignore_errors=True)
        folder.new.mkdir()
        yield folder
        index = {} if drives is None else {"drives": dict(drives)}
        _publish(folder.new, out, before, index | owner)
        for path in set(kept.iterdir()) - folder.used:
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def _own_files(out: Path, owner: dict[str, str], shared: bool) -> set[str]:
    """Return the files in `out` that an earlier run of the stage wrote."""
    if not (out / INDEX).is_file():
        if not shared and any(not path.name.startswith(".") for path in out.glob("*")):
            raise InputError("folder has files that no stage wrote", out, _FIX)
        return set()
    index = read_json(out / INDEX, stage=owner["stage"])
    if {key: index.get(key) for key in owner} != owner:
        raise InputError(f"expected a folder of stage {'@'.join(filter(None, owner.values()))}", out, _FIX)
    return {file for file in index["files"] if (out / file).resolve().is_relative_to(out.resolve())}


def _publish(new: Path, out: Path, before: set[str], index: Mapping[str, Any]) -> None:
    """Replace the files `before` in `out` by those in `new`. Readers of the index find no file of a removed drive."""
    paths = sorted(path.relative_to(new) for path in new.rglob("*"))
    files = [str(path) for path in paths if (new / path).is_file()]
    for file in files:
        if file not in before and (out / file).exists():
            raise InputError("file is in the way, which no stage wrote", out / file, "Move it away")
    for file in before.difference(files):
        (out / file).unlink(missing_ok=True)
    for path in paths:
        if (new / path).is_dir():  # DVC expects also an empty one
            (out / path).mkdir(parents=True, exist_ok=True)
    write_json(out / INDEX, {**index, "files": files}, sort_keys=False)
    for file in files:
        with replacing(out / file) as tmp:
            link(new / file, tmp)


def link(path: str | Path, target: str | Path) -> None:
    """Hard-link a file; copy it if that fails, as between two disks."""
    try:
        os.link(path, target)
    except OSError:
        shutil.copyfile(path, target)
