"""Section ``pictures``: pictures of a few frames."""

from pipeline.base.params import Count, Section


class Pictures(Section):
    key = "pictures"
    frames: Count
