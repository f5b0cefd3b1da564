"""Errors shown to the user as one line, without a traceback."""

import difflib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager


class InputError(ValueError):
    """A fault that the user can fix, rendered as ``<where>: <problem>. <fix>``.

    A validator of pydantic may raise it, as it is a ValueError.
    """

    def __init__(self, problem: str, where: object = "", fix: str = "") -> None:
        """`where`: a file, parameter or drive; `fix`: a sentence or command for the user."""
        # Arguments are positional, so that a worker process can pickle the exception.
        super().__init__(problem, str(where), fix)
        self.problem = problem
        self.where = str(where)
        self.fix = fix

    def __str__(self) -> str:
        message = self.problem
        if self.where:
            message = f"{self.where}: {message}"
        if not self.fix:
            return message
        if not message.endswith(("?", ".")):
            message += "."
        return f"{message} {self.fix}"


class DamagedFile(InputError):
    """A file of one frame cannot be read. ``ingest.on_damaged`` decides whether the stage stops."""


@contextmanager
def error_context(where: object = "", fix: str = "") -> Iterator[None]:
    """Re-raise an InputError with `where` in front of it, and with a `fix` if it has none."""
    try:
        yield
    except InputError as error:
        places = [str(place) for place in (where, error.where) if str(place)]
        raise type(error)(error.problem, ": ".join(places), error.fix or fix) from error


def closest(name: str, options: Sequence[str]) -> str:
    """Return a clause for a message: the `options` most similar to `name`, or all if none is."""
    similar = difflib.get_close_matches(name, options, n=3, cutoff=0.6)
    if similar:
        return f"did you mean {' or '.join(similar)}?"
    return f"known: {', '.join(options) or 'none'}"
