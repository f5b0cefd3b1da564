"""End quietly on Ctrl-C while a command imports its libraries, which takes seconds. Imports no library itself."""

import os
import signal
import sys
from pathlib import Path


def handle_interrupts(*commands: str) -> None:
    """If this process is starting one of `commands`, or ``python -m``, let Ctrl-C and SIGTERM end it with one line.

    :func:`pipeline.base.console.guarded` replaces the handlers once the imports are complete. Ignored signals stay so.
    """
    if sys.argv[0] == "-m" or Path(sys.argv[0]).name in commands:
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, _exit)


def _exit(number: int, frame: object) -> None:
    # An exception could end as an error of the library that is being imported.
    os.write(2, b"error: interrupted. Nothing was written\n")
    os._exit(128 + number)
