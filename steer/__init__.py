"""The command line: steer predict, measure, import, show, diff, doctor and export."""

from pipeline.base import startup

startup.handle_interrupts("steer")
