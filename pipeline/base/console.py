"""Run a stage's ``main`` as a command: arguments by Typer, errors as one line, exit status."""

import errno
import functools
import os
import sys
from collections.abc import Callable

import typer

from pipeline.base.errors import InputError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # the disk, the user's quota, the limit on one file


def run(main: Callable[..., object]) -> None:
    """Parse the command line for `main` and call it.

    An :class:`InputError` or a full disk ends the process with one line on stderr and status 1, Ctrl-C with 130.
    Anything else is a bug and keeps its traceback.
    """

    @functools.wraps(main)  # Typer reads its arguments
    def guarded(*args: object, **options: object) -> None:
        try:
            main(*args, **options)
        except InputError as error:
            _stop(str(error))
        except OSError as error:
            if error.errno not in _FULL:
                raise
            where = f" while writing {error.filename}" if error.filename else ""
            _stop(f"{error.strerror}{where}. Free some space and run the same command again: finished drives are kept.")
        except KeyboardInterrupt:  # Typer would end silently
            _stop("interrupted: finished drives are kept, run the same command again to go on", status=130)

    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(guarded)
    app()


def _stop(message: str, status: int = 1) -> None:
    print(f"error: {' '.join(message.split())}", file=sys.stderr, flush=True)
    sys.exit(status)


def default_workers() -> int:
    """Number of worker processes: ``STEER_WORKERS`` if set, else the cores this process may use.

    Raises InputError if ``STEER_WORKERS`` is no positive whole number.
    """
    text = os.environ.get("STEER_WORKERS", "")
    if not text:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not text.isdigit() or int(text) < 1:
        raise InputError(f"STEER_WORKERS={text!r} is no positive whole number: set it to a number of processes")
    return int(text)
