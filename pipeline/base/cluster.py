"""Workers of a Dask cluster in place of processes of this machine: ``STEER_SCHEDULER=tcp://…``.

They see the same files under the same names. So a job is the name of a function, paths and settings, a few kB, and what
it makes is a file that is written in one step: whoever makes it, or makes it again, its bytes are the same. Dask gives
the job of a worker that died to another.
"""

import io
import logging
import os
import pickle
import pkgutil
import socket
import sys
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any

from pipeline.base import cluster_job
from pipeline.base.errors import InputError
from pipeline.base.jobs import Job

if TYPE_CHECKING:
    from distributed import Client

VARIABLE = "STEER_SCHEDULER"
CONNECT_S = 5
KEPT = "run the same command again, what is finished is kept"


class Cluster:
    """The :class:`pipeline.base.jobs.Workers` of a cluster."""

    def __init__(self, address: str, client: "Client", run: cluster_job.Run) -> None:
        self.done_frames = 0
        self._address, self._client, self._run = address, client, run
        self._executor = client.get_executor(pure=False)

    @property
    def count(self) -> int:
        """How many workers there are, of a thread each; they come and go."""
        try:
            return len(self._client.nthreads())
        except OSError as error:
            raise self._gone() from error

    def submit(self, job: Job) -> Future[Any]:
        call = _Call(cluster_job.do, self._run, _pickled(job.call))
        # Loading it does it: so a worker without this code gets as far as to say so, and the scheduler needs none.
        future: Future[Any] = self._executor.submit(pickle.loads, _pickled(call))
        return future

    def result(self, future: Future[Any], where: str) -> Any:
        from distributed import KilledWorker

        try:
            result, frames = future.result()
        except KilledWorker as error:
            raise InputError(
                f"{error.allowed_failures + 1} workers died (out of memory?) at or near {where}, the last of them "
                f"{error.last_worker.address}: see its log, start fewer on a machine, {KEPT}"
            ) from error
        except CancelledError as error:
            raise self._gone() from error
        except ImportError as error:
            raise InputError(f"a worker of {self._address} lacks what it needs, {error}: {self._run.hint}") from error
        self.done_frames += frames
        return result

    def _gone(self) -> InputError:
        return InputError(f"the scheduler {self._address} is gone: start it again, {KEPT}")


def scheduler() -> str | None:
    """Return the address of the cluster that is to do the jobs; None for processes of this machine."""
    return os.environ.get(VARIABLE) or None


@contextmanager
def joined(address: str, work: Any, modules: str | Sequence[str], mark: Path) -> Iterator[Cluster]:
    """Yield the workers of the scheduler at `address`; each has a copy of `work`, picklable.

    Args:
        modules: dotted names; the workers must have the same code of all that they import.
        mark: a file of this run, by which workers find out whether they see the same files.

    Raises InputError if there is no scheduler.
    """
    modules = (modules,) if isinstance(modules, str) else tuple(modules)
    hint = f"start workers in this environment: dask worker {address} --nthreads 1"
    with _connected(address) as client:
        if not client.nthreads():
            print(f"{address} has no workers yet, and is waited for; {hint}", flush=True)
        run = cluster_job.Run(
            name=uuid.uuid4().hex,
            work=_pickled(work),
            folder=str(Path.cwd()),
            mark=(str(mark), mark.read_text(encoding="utf-8")),
            modules=modules,
            code=cluster_job.code(modules),
            versions=cluster_job.versions(),
            hint=hint,
        )
        yield Cluster(address, client, run)


def _connected(address: str) -> "Client":
    try:
        from distributed import Client
        from distributed.comm.addressing import parse_address, parse_host_port
    except ModuleNotFoundError as error:
        raise InputError(f"{VARIABLE} is set, but {error}: pip install '.[cluster]'") from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # errors here are one line, told once
    try:
        _, place = parse_address(address, strict=True)
        with socket.create_connection(parse_host_port(place), CONNECT_S):
            pass  # a Client that finds nobody says more than a line
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{VARIABLE}={address}: no scheduler answers there ({error}). Start one, dask scheduler, which says its "
            f"address; without {VARIABLE}, this machine does the work alone"
        ) from error


class _Call:
    """A call, which takes place where its pickle is loaded, and is loaded as what it returns."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self._function, self._arguments = function, arguments

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self._function, self._arguments


class _Pickler(pickle.Pickler):
    """Writes names that others can import: what ``python -m NAME`` runs is not __main__ there."""

    def reducer_override(self, value: Any) -> Any:
        spec = sys.modules["__main__"].__spec__
        if spec and isinstance(value, type | FunctionType) and value.__module__ == "__main__":
            return pkgutil.resolve_name, (f"{spec.name}:{value.__qualname__}",)
        return NotImplemented


def _pickled(value: Any) -> bytes:
    stream = io.BytesIO()
    _Pickler(stream).dump(value)
    return stream.getvalue()
