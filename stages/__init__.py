"""One command per DVC stage: ``python -m stages.<name>``."""

from pipeline.base import startup

startup.handle_interrupts()
