"""Run functions as commands: arguments by Typer, errors as one line, exit status."""

import functools
import io
import os
import signal
import sys
from collections.abc import Callable

import typer

from pipeline.base.errors import InputError

RESUME = "Finished drives are kept: repeat the command to continue"


class App(typer.Typer):
    """A command line whose help and version report errors as :func:`guarded` does."""

    def __call__(self, *args: object, **options: object) -> None:
        call = super().__call__
        (call if "--debug" in sys.argv else guarded(call, "Nothing was written"))(*args, **options)


def run(main: Callable[..., object]) -> None:
    """Parse a stage's command line for `main` and call it, :func:`guarded`."""
    app = App(add_completion=False, pretty_exceptions_enable=False)
    app.command()(guarded(main))
    app()


def prepare_streams() -> None:
    """Replace closed standard streams by /dev/null, and escape characters that the encoding of the output lacks.

    Otherwise a file that is opened later takes the number of the closed stream, and libraries print into it.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            stream = open(os.devnull, mode)  # noqa: SIM115, PTH123  # stays open
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def guarded(main: Callable[..., object], after_stop: str = RESUME) -> Callable[..., None]:
    """Return `main` as a command that reports errors as one line on stderr.

    An :class:`InputError` or an OSError (a full disk, no permission, …) exits with status 1, Ctrl-C with 130, SIGTERM
    with 143. Other exceptions are bugs and keep their traceback, as all do with an option `debug`.

    Args:
        after_stop: what an early stop leaves, and how to continue.
    """

    @functools.wraps(main)  # Typer reads its arguments
    def command(*args: object, **options: object) -> None:
        prepare_streams()
        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        if options.get("debug"):
            main(*args, **options)
            return
        signal.signal(signal.SIGTERM, _interrupt)
        try:
            main(*args, **options)
            sys.stdout.flush()
        except InputError as error:
            _exit(str(error))
        except OSError as error:
            files = " → ".join(str(name) for name in (error.filename, error.filename2) if name is not None)
            problem = error.strerror or str(error) or type(error).__name__
            _exit(f"{f'{files}: ' if files else ''}{problem}. {after_stop}")
        except KeyboardInterrupt as error:
            _exit(f"interrupted. {after_stop}", status=143 if error.args == (signal.SIGTERM,) else 130)

    return command


def _interrupt(number: int, frame: object) -> None:
    """End as Ctrl-C does, so that locks are released and temporary files removed."""
    raise KeyboardInterrupt(signal.SIGTERM)


def _exit(message: str, status: int = 1) -> None:
    text = " ".join(message.split()).encode(errors="backslashreplace").decode()  # a file's name may be any bytes
    print(f"error: {text}", file=sys.stderr, flush=True)
    try:
        sys.stdout.flush()
    except OSError:  # a closed pipe or a full disk, to which Python would write again at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(status)
