"""Functions as commands: arguments by Typer, errors as one line, exit status."""

import errno
import functools
import os
import select
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import typer

from pipeline.base.atomic import DISK_FULL
from pipeline.base.errors import InputError

_DVC = "DVC_STAGE"  # DVC gives it to the commands that it runs, and to nobody else
_RIGHTS = (errno.EACCES, errno.EPERM)
_WRONG_KIND = (errno.EISDIR, errno.ENOTDIR, errno.EEXIST, errno.ENOTEMPTY)


def run(main: Callable[..., object]) -> None:
    """Parse a stage's command line for `main` and call it, :func:`guarded`.

    A process that DVC started ends with it, as workers end with this process: DVC, killed, cannot tell it to.
    """

    @functools.wraps(main)  # Typer reads its arguments
    def of_dvc(*args: object, **options: object) -> None:
        if _DVC in os.environ:
            _end_with(_starter(os.environ[_DVC]))
        main(*args, **options)

    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(guarded(of_dvc))
    app()


def guarded(
    main: Callable[..., object], kept: str = "finished drives are kept, run the same command again to go on"
) -> Callable[..., None]:
    """Return `main` as a command that ends as a user expects; `kept` says what an end before its time leaves.

    An :class:`InputError` or an OSError (a full disk, no permission, …) ends the process with one line on stderr and
    status 1, Ctrl-C with 130. Anything else is a bug and keeps its traceback, as all does with an option `debug`.
    """

    @functools.wraps(main)
    def command(*args: object, **options: object) -> None:
        if options.get("debug"):
            main(*args, **options)
            return
        try:
            main(*args, **options)
        except InputError as error:
            _stop(str(error))
        except BrokenPipeError:  # commands print, to a pipe that is gone; Python would try once more as it ends
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            _stop(f"the output pipe is closed: {kept}")
        except OSError as error:
            _stop(_explain(error, kept))
        except KeyboardInterrupt:  # Typer would end silently
            _stop(f"interrupted: {kept}", status=130)

    return command


def _stop(message: str, status: int = 1) -> None:
    print(f"error: {' '.join(message.split())}", file=sys.stderr, flush=True)
    sys.exit(status)


def _explain(error: OSError, kept: str) -> str:
    """Return what went wrong, with which file, and what to do about it."""
    files = " → ".join(str(name) for name in (error.filename, error.filename2) if name is not None)
    message = error.strerror or str(error) or type(error).__name__
    if error.errno in DISK_FULL:
        where = f" while writing {files}" if files else ""
        return f"{message}{where}. Free some space: {kept}."
    message += f": {files}" if files else ""
    link = _dangling(Path(str(error.filename))) if files else None
    if link:
        hint = f"{link} is a link to {link.readlink()}, which is missing: mount or make that, or remove the link"
    elif error.errno in _RIGHTS:
        hint = f"See whose it is with ls -ld {error.filename}, and change that with chown or chmod"
    elif error.errno == errno.EROFS:
        hint = "The file system is read-only: mount it for writing, or choose a folder elsewhere"
    elif error.errno in _WRONG_KIND:
        hint = "Something of another kind has this name, or that of a folder above it: move it away"
    elif error.errno == errno.ENOENT:
        hint = "dvc repro makes what is missing in data/, dvc pull brings it from another machine"
    else:
        hint = "This is the system's own message: see to the disk or the network, and run the same command again"
    return f"{message}. {hint}"


def _dangling(path: Path) -> Path | None:
    """Return the link that leads nowhere, `path` or a folder on the way to it."""
    try:
        return next((link for link in (path, *path.parents) if link.is_symlink() and not link.exists()), None)
    except OSError:  # a name above 255 characters
        return None


def _starter(stage: str) -> int:
    """Return the process id of the DVC that runs this `stage`: the nearest ancestor that was not started for it.

    DVC runs a command by a shell, which may stay between, or turn into the command itself. 0 or 1 if there is none.
    """
    pid = os.getppid()
    try:
        while pid > 1 and f"{_DVC}={stage}".encode() in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0"):
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2]  # the name before may hold anything
            pid = int(fields.split()[1])
    except OSError:
        pass  # ended just now, or another user's, as DVC may be
    return pid


def _end_with(pid: int) -> None:
    """End this process as soon as process `pid` ends, whatever it is doing."""
    if pid <= 1:  # nothing outlives a container's first process
        return
    try:
        process = os.pidfd_open(pid)
    except ProcessLookupError:  # ended just now
        os._exit(1)
    except OSError:  # not in this kernel, or forbidden in this container
        return

    def watch() -> None:
        select.select([process], [], [])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
