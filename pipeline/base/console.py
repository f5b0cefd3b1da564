"""Run functions as commands: arguments by Typer, errors as one line."""

import functools
import sys
from collections.abc import Callable

import typer

from pipeline.base.errors import InputError


def run(*commands: Callable[..., object]) -> None:
    """Parse the command line and call the function, :func:`guarded`.

    With several functions, the first argument is the name of one.
    """
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    for command in commands:
        app.command()(guarded(command))
    app()


def guarded(main: Callable[..., object]) -> Callable[..., None]:
    """Return `main` as a command that prints an InputError, an OSError or Ctrl-C as one line.

    Its exit status is 1 then.
    """

    @functools.wraps(main)  # Typer reads its arguments
    def command(*args: object, **options: object) -> None:
        try:
            main(*args, **options)
        except (InputError, OSError, KeyboardInterrupt) as error:
            one_line = " ".join(_message(error).split())
            sys.exit(f"error: {one_line}")

    return command


def _message(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    if isinstance(error, KeyboardInterrupt):
        return "interrupted. Repeat the command to continue: complete files are kept"
    return str(error)
