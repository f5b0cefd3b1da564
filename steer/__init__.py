"""The command line: steer predict, measure, import, show and diff."""

from pipeline.base import startup

startup.handle_interrupts("steer")
