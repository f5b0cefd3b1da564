"""Run functions as commands: arguments by Typer, errors as one line."""

import functools
import sys
from collections.abc import Callable

import typer

from pipeline.base.errors import InputError


def run(*commands: Callable[..., object]) -> None:
    """Parse the command line and call the function, :func:`guarded`; its first argument names one
    of several.
    """
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    for command in commands:
        app.command()(guarded(command))
    app()


def guarded(main: Callable[..., object]) -> Callable[..., None]:
    """Return `main` as a command that prints an InputError, an OSError or Ctrl-C as one line, with
    exit status 1.
    """

    @functools.wraps(main)  # Typer reads its arguments
    def command(*args: object, **options: object) -> None:
        try:
            main(*args, **options)
        except (InputError, OSError, KeyboardInterrupt) as error:
            message = (
                str(error) or "interrupted. Repeat the command to continue: complete files are kept"
            )
            if isinstance(error, OSError) and error.strerror:
                message = (
                    f"{error.filename}: {error.strerror}" if error.filename else error.strerror
                )
            sys.exit(f"error: {' '.join(message.split())}")

    return command
