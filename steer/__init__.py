"""The command line: steer predict, measure, import and show."""

from pipeline.base import startup

startup.handle_interrupts("steer")
