"""The rule for a stage's folder: index.json lists the files of the stage, and the stage replaces these only."""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from filelock import FileLock, Timeout

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.base.store import read_json, write_json

INDEX = "index.json"


class StageFolder(NamedTuple):
    """Where a stage works while it runs.

    Attributes:
        stage: its name in ``dvc.yaml``.
        new: an empty folder. What the stage writes here becomes the content of its output folder.
        kept: ``data/.drives/STAGE``, or ``data/.drives/STAGE-ENTRY``, outside of all DVC outputs, for the next run.
        used: paths directly in `kept` that this run needs. The others are removed when it succeeds.
    """

    stage: str
    new: Path
    kept: Path
    used: set[Path]


@contextmanager
def stage_folder(stage: str, out: Path, *, shared: bool = False) -> Iterator[StageFolder]:
    """Hold the lock of the output folder `out`, and publish what the block writes when it ends without error.

    The files in ``StageFolder.new`` replace those that an earlier run listed in ``out/index.json``. The new index adds
    ``stage``, ``entry`` and ``files`` to an index.json of the block.

    Args:
        stage: name in ``dvc.yaml``, ``graphs@NAME`` for an entry, whose `out` is a folder in the stage's folder.
        shared: whether `out` may hold other files.

    Raises InputError if another process writes `out`, or if `out` holds files that this stage did not write.
    """
    name, _, entry = stage.partition("@")
    root = out.parent if entry else out
    kept = root.with_name(".drives") / "-".join(filter(None, [root.name, entry and out.name]))
    kept.mkdir(parents=True, exist_ok=True)
    try:
        lock = FileLock(f"{kept}.lock").acquire(timeout=0)
    except Timeout:
        problem, fix = "another process is writing it", "Wait for that to end, then repeat the command"
        raise InputError(problem, out, fix) from None
    with lock:
        owner = {"stage": name, "entry": entry}
        before = _own_files(out, owner, shared)
        folder = StageFolder(name, kept / "new", kept, set())
        shutil.rmtree(folder.new, ignore_errors=True)
        folder.new.mkdir()
        yield folder
        _publish(folder.new, out, before, owner)
        for path in set(kept.iterdir()) - folder.used:
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def _own_files(out: Path, owner: dict[str, str], shared: bool) -> set[str]:
    """Return the files in `out` that an earlier run of the stage wrote."""
    fix = "Pass another --out, or move it away"
    if not (out / INDEX).is_file():
        if not shared and any(not path.name.startswith(".") for path in out.glob("*")):
            raise InputError("folder has files that no stage wrote", out, fix)
        return set()
    index = read_json(out / INDEX, stage=owner["stage"])
    if {key: index.get(key) for key in owner} != owner:
        raise InputError(f"expected a folder of stage {'@'.join(filter(None, owner.values()))}", out, fix)
    return {file for file in index["files"] if (out / file).resolve().is_relative_to(out.resolve())}


def _publish(new: Path, out: Path, before: set[str], owner: dict[str, str]) -> None:
    """Replace the files `before` in `out` by those in `new`. Readers of the index find no file of a removed drive."""
    paths = sorted(path.relative_to(new) for path in new.rglob("*"))
    files = [str(path) for path in paths if (new / path).is_file() and str(path) != INDEX]
    for file in files:
        if file not in before and (out / file).exists():
            raise InputError("file is in the way, which no stage wrote", out / file, "Move it away")
    index: dict[str, Any] = json.loads((new / INDEX).read_text()) if (new / INDEX).exists() else {}
    for file in before.difference(files):
        (out / file).unlink(missing_ok=True)
    for path in [out, *(out / path for path in paths if (new / path).is_dir())]:
        path.mkdir(parents=True, exist_ok=True)
    write_json(out / INDEX, index | owner | {"files": files}, sort_keys=False)
    for file in files:
        with replacing(out / file) as tmp:
            link(new / file, tmp)


def link(path: str | Path, target: str | Path) -> None:
    """Give a file a second name; copy it to another disk, and where there are no hard links."""
    try:
        os.link(path, target)
    except OSError:
        shutil.copyfile(path, target)
