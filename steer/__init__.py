"""The command line: steer predict, measure, import, show, diff and export."""

from pipeline.base import startup

startup.handle_interrupts("steer")
