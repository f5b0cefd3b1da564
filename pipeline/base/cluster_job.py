"""A job as a worker of a Dask cluster does it, after a look at whether that worker is fit for it.

It must have this code and these libraries, one thread, and see the same files under the same names.
"""

import hashlib
import io
import os
import pickle
import platform
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any, TextIO

from pipeline.base import progress, provenance
from pipeline.base.errors import InputError

LIBRARIES = ("numpy", "scipy", "torch", "opencv-python-headless", "open3d", "h5py", "hdf5plugin")  # they make the bytes


@dataclass(frozen=True)
class Run:
    """What a worker has to know of a stage's run."""

    name: str  # no other run's
    work: bytes  # pickled
    folder: str  # where relative paths begin
    mark: tuple[str, str]  # a file of this run, and what it holds
    modules: tuple[str, ...]  # whose code does the work
    code: str  # :func:`code` of them
    versions: dict[str, str]
    hint: str  # how workers are started

    def __hash__(self) -> int:
        return hash(self.name)


def code(modules: Sequence[str]) -> str:
    """Return a hash of what `modules` import, as this process may have imported it: files count as it saw them first.

    A worker lives for many runs, and a file that was edited since is another one to it.
    """
    paths = provenance.import_closure(*modules)
    return hashlib.sha256(b"".join(str(path).encode() + _first_seen(path) for path in paths)).hexdigest()


@cache
def _first_seen(path: Path) -> bytes:
    return hashlib.sha256((provenance.ROOT / path).read_bytes()).digest()


def versions() -> dict[str, str]:
    """Return the versions of what else the bytes of a file depend on."""
    return {"Python": platform.python_version(), **{name: metadata.version(name) for name in LIBRARIES}}


def do(run: Run, call: bytes) -> tuple[Any, int]:
    """Do a job, pickled. Returns what it returns, and how many frames it told of.

    Raises InputError if this worker is not fit for it.
    """
    frames = 0

    def count(more: int) -> None:
        nonlocal frames
        frames += more

    try:
        os.chdir(run.folder)
    except OSError:
        raise InputError(_unseen(run.folder)) from None
    work = _work(run)
    progress.listen(count)
    job: Callable[[Any], Any] = pickle.loads(call)
    with redirect_stdout(_Relay(sys.stdout)):
        result = job(work)
    return result, frames


class _Relay(io.TextIOBase):
    """Prints here, on `stdout`, and where the stage was started."""

    def __init__(self, stdout: TextIO) -> None:
        self._stdout = stdout

    def write(self, text: str) -> int:
        import distributed

        with redirect_stdout(self._stdout):
            distributed.print(text, end="", file=sys.stdout, flush=True)
        return len(text)


@lru_cache(maxsize=2)  # of two stages at a time
def _work(run: Run) -> Any:
    """Return this process's copy of a run's work."""
    import cv2

    _check(run)
    cv2.setNumThreads(1)
    work = pickle.loads(run.work)
    if "torch" in sys.modules:  # else it reads OMP_NUM_THREADS, which dask worker sets to 1
        sys.modules["torch"].set_num_threads(1)
    return work


def _check(run: Run) -> None:
    from distributed import get_worker

    worker = get_worker()
    if worker.state.nthreads != 1:
        raise InputError(f"worker {worker.address} has {worker.state.nthreads} threads, and may have one: {run.hint}")
    own = versions()
    others = [f"{name} {own[name]} instead of {wanted}" for name, wanted in run.versions.items() if own[name] != wanted]
    if others:
        raise InputError(f"worker {worker.address} has {', '.join(others)}: {run.hint}")
    if code(run.modules) != run.code:
        raise InputError(
            f"worker {worker.address} runs another version of the code of {' '.join(run.modules)}, in "
            f"{provenance.ROOT}, or did before an edit: end it, and {run.hint}"
        )
    path, content = run.mark
    try:
        same = Path(path).read_text(encoding="utf-8") == content
    except OSError:
        same = False
    if not same:
        raise InputError(_unseen(str(Path(path).absolute().parent)))


def _unseen(folder: str) -> str:
    from distributed import get_worker

    return (
        f"worker {get_worker().address} does not see the same files in {folder}: code and data must lie under the same "
        "path on all machines, on a file system that they share and that shows new files at once (docs/cluster.md)"
    )
