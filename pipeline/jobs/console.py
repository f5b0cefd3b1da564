"""Run functions as commands: Typer parses the arguments, and errors are printed as one line."""

import functools
import sys
from collections.abc import Callable
from typing import Annotated

import typer

from pipeline.base.errors import InputError

# Argument of a stage with entries: a variant or a model.
EntryName = Annotated[
    str | None,
    typer.Argument(metavar="NAME", help="an entry of the params file; default: DVC's"),
]


def run(*commands: Callable[..., object]) -> None:
    """Parse the command line and call the command, which is :func:`guarded`.

    If there are several commands, the first argument is the name of the one to call.
    """
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    for command in commands:
        app.command()(guarded(command))
    app()


def guarded(main: Callable[..., object]) -> Callable[..., None]:
    """Return `main` as a command that prints an InputError, an OSError or Ctrl-C as one line.

    After any of these, the exit status is 1.
    """

    # Typer reads the arguments of `main` through the wrapper.
    @functools.wraps(main)
    def command(*args: object, **options: object) -> None:
        try:
            main(*args, **options)
        except (InputError, OSError, KeyboardInterrupt) as error:
            one_line = " ".join(_describe_error(error).split())
            sys.exit(f"error: {one_line}")

    return command


def _describe_error(error: BaseException) -> str:
    """Return the text about an exception, which may have several lines."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    if isinstance(error, KeyboardInterrupt):
        return "interrupted. Repeat the command to continue: complete files are kept"
    return str(error)
