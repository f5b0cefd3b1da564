"""The one exception that a user is meant to read."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager


class InputError(Exception):
    """Something outside the program is wrong: a file, a parameter, a machine.

    The message is one line: what is wrong, where, and what to do about it. :func:`pipeline.base.console.run`
    prints it without a traceback and exits with status 1.
    """


class DamagedFile(InputError):
    """One frame's file cannot be read. ``ingest.on_damaged`` decides whether that ends the stage."""


@contextmanager
def explained(where: str = "", hint: str = "") -> Iterator[None]:
    """Make what goes wrong in the block one InputError: where it went wrong, what it said, what to do about it.

    Catches InputError and ValueError; a DamagedFile stays one.
    """
    try:
        yield
    except (InputError, ValueError) as error:
        kind = DamagedFile if isinstance(error, DamagedFile) else InputError
        message = f"{where}: {error}" if where else str(error)
        raise kind(f"{message.rstrip('.')}. {hint}" if hint else message) from error


def closest(name: str, known: Sequence[str]) -> str:
    """Return a clause for an error message: what of `known` the user may have meant by `name`."""
    import difflib

    near = difflib.get_close_matches(name, known, n=3, cutoff=0.6)
    if near:
        return f"did you mean {' or '.join(near)}?"
    return f"known: {', '.join(known) if known else 'none'}"
