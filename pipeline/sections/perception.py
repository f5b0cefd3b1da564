"""Section ``perception``: running the unified encoder."""

from pipeline.params import Count, Section


class Perception(Section):
    key = "perception"
    batch: Count
