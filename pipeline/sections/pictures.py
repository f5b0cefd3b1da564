"""Section ``pictures``: contact sheets of each drive."""

from pipeline.base.params import Count, Section


class Pictures(Section):
    key = "pictures"
    frames: Count
